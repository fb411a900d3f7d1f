"""The manifest keys of a checkpoint on one robot: `model_io` and others."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl import robots
from xpl.embodiment import UnknownEmbodimentError, get_embodiment
from xpl_cli.adopt.checkpoints import block, registry
from xpl_cli.adopt.facts import Evidence, Fact, Tree, certain, likely, plain
from xpl_cli.basics.errors import UserError, one_of

if TYPE_CHECKING:
    from xpl.embodiment import Embodiment
    from xpl_cli.adopt.checkpoints.trained_model import TrainedModel

MODEL_IO: Final = "model_io"
_SNAPSHOT: Final = re.compile(r"models--(?P<owner>[^/]+?)--(?P<name>[^/]+)/snapshots/(?P<commit>[0-9a-f]{40})$")


@dataclass(frozen=True)
class AdoptedCheckpoint:
    """A checkpoint, as read for one robot.

    Attributes:
        trained: the model, in the framework's terms.
        robot: the embodiment.
        robot_fact: its name with the source.
        tree: the model_io block.
        action_type: joint or ee.
        path: the folder.
    """

    trained: TrainedModel
    robot: Embodiment
    robot_fact: Fact
    tree: Mapping[str, Tree]
    action_type: str
    path: Path

    @property
    def checkpoint(self) -> str:
        """The name of the checkpoint: that on the hub, or of the run's folder."""
        snapshot = _SNAPSHOT.search(self.path.absolute().as_posix())
        parts = self.path.resolve().parts
        names = [snapshot["name"]] if snapshot else [part for part in parts if part != "pretrained_model"]
        return re.sub(r"[^A-Za-z0-9._+-]", "_", names[-1]).lstrip("._+-")[:100] or "trained"

    @property
    def history(self) -> int:
        """Number of observations that the model reads."""
        length = plain(self.trained.history)["length"] if self.trained.history else 1
        return length if isinstance(length, int) else 1

    @property
    def draws(self) -> bool:
        """Whether the model may draw random numbers."""
        return bool(plain(self.tree["sampling"]) != "none")

    def sections(self) -> dict[str, Tree]:
        """Return the top-level keys of policy.yml that the checkpoint supplies."""
        trained, sampling = self.trained, self.trained.sampling
        seeded: Tree = True
        if isinstance(sampling, Fact):
            seeded = Fact(sampling.value != "free", sampling.confidence, sampling.evidence)
        result: dict[str, Tree] = {
            "summary": likely(trained.about, *trained.family.evidence),
            "family": trained.family,
            "temporal": block.temporal(trained),
            "inputs": block.inputs(self.tree, self.robot),
            "cameras": block.camera_sizes(trained, self.tree),
            "embodiments": self.robot_fact,
            "action_types": [self.action_type],
            "deterministic": seeded,
            "evaluation_only": True,
        }
        if trained.requirements:
            requirements = ["numpy>=1.24", *trained.requirements]
            result["environment"] = {"manager": "uv", "python": ">=3.10", "requirements": requirements}
        if trained.rate is not None:
            result["control_frequency"] = trained.rate
        if trained.upstream is not None:
            result["upstream"] = trained.upstream
        if (hub := _SNAPSHOT.search(self.path.absolute().as_posix())) is not None:
            source = {"source": f"hf://{hub['owner']}/{hub['name']}", "revision": hub["commit"]}
            where = Evidence("", None, "the folder in the hub's cache")
            result["checkpoints"] = [certain({"name": self.checkpoint, **source}, where)]
        return {**result, MODEL_IO: self.tree}


def read(
    paths: Sequence[Path], embodiment: str | None, action_type: str | None, choices: block.UserChoices
) -> AdoptedCheckpoint:
    """Read a checkpoint.

    Args:
        paths: its folder, and optionally its dataset's or its framework's code.
        embodiment: the robot; None to take it from the dataset.
        action_type: joint or ee; None to take it from the parts of the action.
        choices: cameras, grippers, statistics.

    Raises:
        UserError: no framework recognises the folders, or the robot is unknown.
    """
    trained, folder = registry.read(paths, choices.statistics)
    robot, robot_fact = _robot(trained, embodiment)
    tree = block.model_io(trained, robot, choices)
    return AdoptedCheckpoint(
        trained, robot, robot_fact, tree, action_type or _action_type(plain(tree["action"]["parts"])), folder.path
    )


def _robot(trained: TrainedModel, requested: str | None) -> tuple[Embodiment, Fact]:
    """Return the robot and its name with the source.

    Raises:
        UserError: no file names the robot; the hint lists the robots with as many numbers.
    """
    names = robots.entries()
    if requested is not None:
        one_of("--embodiment", requested, names)
        return get_embodiment(requested), certain([requested], Evidence("", None, "given with --embodiment"))
    if trained.robot is not None:
        try:
            robot = get_embodiment(str(trained.robot.value))
        except UnknownEmbodimentError:
            pass
        else:
            return robot, likely([robot.name], *trained.robot.evidence)
    width = trained.action.numbers.width
    fitting = [name for name in names if _joints(get_embodiment(name)) == width] or list(names)
    called = f"the files call it {trained.robot.value!r}" if trained.robot else "no file names it"
    size = f"; an action has {width} numbers" if width else ""
    raise UserError(f"which robot is it? {called}{size}", hint=f"--embodiment NAME: {', '.join(fitting)}")


def _joints(robot: Embodiment) -> int:
    return sum(arm.dof + arm.ee_dim for arm in robot.arms)


def _action_type(parts: object) -> str:
    """Return the action type of an action's parts: ee for poses, else joint."""
    joint, ee = sdk.ACTION_TYPES
    kinds = {kind for part in parts for kind in part} if isinstance(parts, list) else set()
    return str(ee if kinds & {"position", "rotation"} else joint)
