"""Recognises whose files a folder holds, and reads them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.checkpoints.makers import diffusion_policy, groot, openpi, openvla, rdt, robomimic, starvla
from xpl_cli.adopt.checkpoints.makers.lerobot import checkpoint as lerobot
from xpl_cli.adopt.checkpoints.makers.lerobot import dataset
from xpl_cli.adopt.checkpoints.reading import Folder
from xpl_cli.basics.errors import NotFoundError, UserError

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.adopt.checkpoints.makers.lerobot.dataset import Dataset
    from xpl_cli.adopt.checkpoints.trained import Trained


@dataclass(frozen=True)
class Beside:
    """What else the user gave, and chose.

    Attributes:
        data: the data set that the model was trained on.
        code: a checkout of the maker's code.
        key: which entry of a file of statistics counts.
    """

    data: Dataset | None = None
    code: Folder | None = None
    key: str | None = None


@dataclass(frozen=True)
class Maker:
    """One maker of checkpoints.

    Attributes:
        name: as people know it.
        inner: returns the folder that holds a checkpoint's files, given one that may; None if it is not this maker's.
        read: reads it.
    """

    name: str
    inner: Callable[[Folder], Folder | None]
    read: Callable[[Folder, Beside], Trained]


_MOST_INPUTS: Final = 64

MAKERS = (
    Maker("LeRobot", lerobot.inner, lambda folder, beside: lerobot.read(folder, beside.data)),
    Maker("openpi", openpi.inner, lambda folder, beside: openpi.read(folder, beside.key, beside.code)),
    Maker("Isaac-GR00T", groot.inner, lambda folder, beside: groot.read(folder, beside.key)),
    Maker("OpenVLA", openvla.inner, lambda folder, beside: openvla.read(folder, beside.key)),
    Maker("StarVLA", starvla.inner, lambda folder, beside: starvla.read(folder, beside.key)),
    Maker("RDT", rdt.inner, lambda folder, _beside: rdt.read(folder)),
    Maker("Diffusion Policy", diffusion_policy.inner, lambda folder, _beside: diffusion_policy.read(folder)),
    Maker("robomimic", robomimic.inner, lambda folder, _beside: robomimic.read(folder)),
)


def read(paths: Sequence[Path], key: str | None = None) -> tuple[Trained, Folder]:
    """Return what was trained, and the folder of the checkpoint.

    Args:
        paths: the folder of one checkpoint; of the data set that it was trained on, or a checkout of its maker's code,
            if the user has that too.
        key: which entry of a file of statistics counts, where it holds those of several data sets.

    Raises:
        NotFoundError: if there is no such folder.
        UserError: if it is nobody's that is known, or several checkpoints, or a file in it is not what it should be.
    """
    data, code, found = None, None, []
    for path in paths:
        folder = _folder(path)
        if dataset.recognises(folder):
            data = dataset.read(folder)
        elif folder.has(openpi.CONFIGS):
            code = folder
        elif (known := recognised(folder)) is not None:
            found.append(known)
        else:
            raise UserError(
                f"{path} is no checkpoint that is known: expected one of {', '.join(maker.name for maker in MAKERS)}",
                hint="give the folder that holds its configuration, or the run that it lies in",
            )
    if len(found) != 1:
        what = f"{len(found)} checkpoints" if found else "a data set or code, and no checkpoint"
        raise UserError(f"--from was given {what}: expected one checkpoint, and its data set where you have it")
    maker, folder = found[0]
    try:
        return _usable(maker.read(folder, Beside(data, code, key))), folder
    except UserError as error:
        if str(folder.path) in str(error):
            raise
        raise UserError(f"{folder.path}: {error}", hint=error.hint, code=error.code) from None


def _usable(trained: Trained) -> Trained:
    """Return what was read.

    Raises:
        UserError: it has more inputs than any model: each is a line of what is written, and several of what is told.
    """
    names = [name for view in trained.views for name in view.names]
    if max(len(trained.views), len(names), len(trained.states)) > _MOST_INPUTS:
        raise UserError(
            f"it lists {len(trained.views)} image inputs of {len(names)} cameras and {len(trained.states)} vectors, "
            f"expected {_MOST_INPUTS} of each at most"
        )
    return trained


def recognised(folder: Folder) -> tuple[Maker, Folder] | None:
    """Return whose checkpoint a folder holds, and where its files are; None if it is nobody's that is known."""
    for maker in MAKERS:
        place = maker.inner(folder)
        if place is not None:
            return maker, place
    return None


def _folder(path: Path) -> Folder:
    if not path.exists():
        raise NotFoundError(f"there is no {path}")
    if not path.is_dir():
        raise UserError(f"{path} is a file: expected the folder that training wrote")
    # A data set is told by its name, since the checkpoint's files go by their names alone.
    return Folder(path, path.resolve().name if dataset.recognises(Folder(path)) else "")
