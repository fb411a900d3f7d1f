"""Recognition of the framework that wrote a checkpoint, and its readers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.checkpoints.frameworks import diffusion_policy, groot, openpi, openvla, rdt, robomimic, starvla
from xpl_cli.adopt.checkpoints.frameworks.lerobot import checkpoint as lerobot
from xpl_cli.adopt.checkpoints.frameworks.lerobot import dataset
from xpl_cli.adopt.checkpoints.reading import CheckpointFolder
from xpl_cli.basics.errors import NotFoundError, UserError

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.adopt.checkpoints.frameworks.lerobot.dataset import LeRobotDataset
    from xpl_cli.adopt.checkpoints.trained_model import TrainedModel


@dataclass(frozen=True)
class ReadOptions:
    """Further input of the user.

    Attributes:
        data: the dataset that the model was trained on.
        code: a checkout of the framework's code.
        key: entry of the statistics file.
    """

    data: LeRobotDataset | None = None
    code: CheckpointFolder | None = None
    key: str | None = None


@dataclass(frozen=True)
class Framework:
    """A framework that writes checkpoints.

    Attributes:
        name: its usual name.
        inner: returns the folder of the checkpoint's files inside a given one; None if it is not this framework's.
        read: reads the checkpoint.
    """

    name: str
    inner: Callable[[CheckpointFolder], CheckpointFolder | None]
    read: Callable[[CheckpointFolder, ReadOptions], TrainedModel]


_MOST_INPUTS: Final = 64

FRAMEWORKS = (
    Framework("LeRobot", lerobot.inner, lambda folder, beside: lerobot.read(folder, beside.data)),
    Framework("openpi", openpi.inner, lambda folder, beside: openpi.read(folder, beside.key, beside.code)),
    Framework("Isaac-GR00T", groot.inner, lambda folder, beside: groot.read(folder, beside.key)),
    Framework("OpenVLA", openvla.inner, lambda folder, beside: openvla.read(folder, beside.key)),
    Framework("StarVLA", starvla.inner, lambda folder, beside: starvla.read(folder, beside.key)),
    Framework("RDT", rdt.inner, lambda folder, _beside: rdt.read(folder)),
    Framework("Diffusion Policy", diffusion_policy.inner, lambda folder, _beside: diffusion_policy.read(folder)),
    Framework("robomimic", robomimic.inner, lambda folder, _beside: robomimic.read(folder)),
)


def read(paths: Sequence[Path], key: str | None = None) -> tuple[TrainedModel, CheckpointFolder]:
    """Read a checkpoint; return the model and the checkpoint's folder.

    Args:
        paths: the folder of one checkpoint; optionally that of its dataset, and a checkout of its framework's code.
        key: entry of the statistics file, where it has several datasets.

    Raises:
        NotFoundError: a folder does not exist.
        UserError: no framework recognises the folder, there are several checkpoints, or a file is invalid.
    """
    data, code, checkpoints = None, None, []
    for path in paths:
        folder = _folder(path)
        if dataset.recognises(folder):
            data = dataset.read(folder)
        elif folder.has(openpi.CONFIGS):
            code = folder
        elif (match := recognise(folder)) is not None:
            checkpoints.append(match)
        else:
            raise UserError(
                f"{path} is no known checkpoint: expected {', '.join(framework.name for framework in FRAMEWORKS)}",
                hint="give the folder of its configuration, or of the training run",
            )
    if len(checkpoints) != 1:
        what = f"{len(checkpoints)} checkpoints" if checkpoints else "a dataset or code, and no checkpoint"
        raise UserError(f"--from got {what}: expected one checkpoint, and optionally its dataset")
    maker, folder = checkpoints[0]
    try:
        return _usable(maker.read(folder, ReadOptions(data, code, key))), folder
    except UserError as error:
        if str(folder.path) in str(error):
            raise
        raise UserError(f"{folder.path}: {error}", hint=error.hint, code=error.code) from None


def _usable(trained: TrainedModel) -> TrainedModel:
    """Return the model if its number of inputs is plausible.

    Raises:
        UserError: it has more inputs than any model.
    """
    names = [name for view in trained.views for name in view.names]
    if max(len(trained.views), len(names), len(trained.states)) > _MOST_INPUTS:
        raise UserError(
            f"it lists {len(trained.views)} image inputs of {len(names)} cameras and {len(trained.states)} vectors, "
            f"expected {_MOST_INPUTS} of each at most"
        )
    return trained


def recognise(folder: CheckpointFolder) -> tuple[Framework, CheckpointFolder] | None:
    """Return the framework of a checkpoint and the folder of its files; None if no framework recognises it."""
    for framework in FRAMEWORKS:
        inner = framework.inner(folder)
        if inner is not None:
            return framework, inner
    return None


def _folder(path: Path) -> CheckpointFolder:
    if not path.exists():
        raise NotFoundError(f"there is no {path}")
    if not path.is_dir():
        raise UserError(f"{path} is a file: expected the folder that training wrote")
    # Evidence names the dataset's folder; files of the checkpoint have no prefix.
    return CheckpointFolder(path, path.resolve().name if dataset.recognises(CheckpointFolder(path)) else "")
