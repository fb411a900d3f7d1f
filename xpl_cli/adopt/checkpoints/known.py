"""What a checkpoint says of a policy on one robot: the block `model_io`, and what else of a manifest it fills."""

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
from xpl_cli.adopt.facts import Evidence, Told, Tree, certain, likely, plain
from xpl_cli.basics.errors import UserError, one_of

if TYPE_CHECKING:
    from xpl.embodiment import Embodiment
    from xpl_cli.adopt.checkpoints.trained import Trained

"""The standard of what is read from a checkpoint: the first that has a model_io block."""
MODEL_IO: Final = "model_io"
ENVIRONMENTS: Final = {
    "lerobot": {"manager": "uv", "python": ">=3.10", "requirements": ["numpy>=1.24", "lerobot>=0.4"]}
}
"""Makers whose library runs any of their checkpoints, so that a whole adapter can be written."""

_SNAPSHOT: Final = re.compile(r"models--(?P<owner>[^/]+?)--(?P<name>[^/]+)/snapshots/(?P<commit>[0-9a-f]{40})$")


@dataclass(frozen=True)
class Known:
    """What was read.

    Attributes:
        trained: the model, in its maker's terms.
        robot: whose numbers it holds.
        named: where the robot was read.
        tree: the model_io block.
        action_type: joint or ee.
        path: the folder.
    """

    trained: Trained
    robot: Embodiment
    named: Told
    tree: Mapping[str, Tree]
    action_type: str
    path: Path

    @property
    def checkpoint(self) -> str:
        """The name of the checkpoint: the hub's, or that of the run that it lies in."""
        found = _SNAPSHOT.search(self.path.absolute().as_posix())
        parts = self.path.resolve().parts
        names = [found["name"]] if found else [part for part in parts if part != "pretrained_model"]
        return re.sub(r"[^A-Za-z0-9._+-]", "_", names[-1]).lstrip("._+-")[:100] or "trained"

    @property
    def history(self) -> int:
        """Observations that the model sees."""
        length = plain(self.trained.history)["length"] if self.trained.history else 1
        return length if isinstance(length, int) else 1

    @property
    def draws(self) -> bool:
        """Whether the model draws random numbers, as far as anybody knows."""
        return bool(plain(self.tree["sampling"]) != "none")

    def sections(self) -> dict[str, Tree]:
        """Return the top-level keys of policy.yml that it fills."""
        trained, sampling = self.trained, self.trained.sampling
        seeded: Tree = True
        if isinstance(sampling, Told):
            seeded = Told(sampling.value != "free", sampling.confidence, sampling.evidence)
        result: dict[str, Tree] = {
            "summary": likely(trained.about, *trained.family.evidence),
            "family": trained.family,
            "temporal": block.temporal(trained),
            "inputs": block.inputs(self.tree, self.robot),
            "cameras": block.smallest(trained, self.tree),
            "embodiments": self.named,
            "action_types": [self.action_type],
            "deterministic": seeded,
            "evaluation_only": True,
        }
        if trained.maker in ENVIRONMENTS:
            result["environment"] = dict(ENVIRONMENTS[trained.maker])
        if trained.rate is not None:
            result["control_frequency"] = trained.rate
        if trained.upstream is not None:
            result["upstream"] = trained.upstream
        if (hub := _SNAPSHOT.search(self.path.absolute().as_posix())) is not None:
            source = {"source": f"hf://{hub['owner']}/{hub['name']}", "revision": hub["commit"]}
            where = Evidence("", None, "the folder in the hub's cache")
            result["checkpoints"] = [certain({"name": self.checkpoint, **source}, where)]
        return {**result, MODEL_IO: self.tree}


def read(paths: Sequence[Path], embodiment: str | None, action_type: str | None, choices: block.Choices) -> Known:
    """Return what a checkpoint says.

    Args:
        paths: its folder, and its data set's or its maker's code where the user has that.
        embodiment: the robot; None to take it from the data.
        action_type: joint or ee; None to take it from the answer's parts.
        choices: cameras, grippers, statistics.

    Raises:
        UserError: if the folders hold nothing that is known, or the robot is not.
    """
    trained, folder = registry.read(paths, choices.statistics)
    robot, named = _robot(trained, embodiment)
    tree = block.model_io(trained, robot, choices)
    return Known(trained, robot, named, tree, action_type or _action_type(plain(tree["action"]["parts"])), folder.path)


def _robot(trained: Trained, given: str | None) -> tuple[Embodiment, Told]:
    """Return the robot and where it was read.

    Raises:
        UserError: with the robots that have as many numbers, if nothing says which it is.
    """
    known = robots.entries()
    if given is not None:
        one_of("--embodiment", given, known)
        return get_embodiment(given), certain([given], Evidence("", None, "given with --embodiment"))
    if trained.robot is not None:
        try:
            robot = get_embodiment(str(trained.robot.value))
        except UnknownEmbodimentError:
            pass
        else:
            return robot, likely([robot.name], *trained.robot.evidence)
    width = trained.action.numbers.width
    fitting = [name for name in known if _joints(get_embodiment(name)) == width] or list(known)
    called = f"the files call it {trained.robot.value!r}" if trained.robot else "nothing in the files names it"
    size = f"; an action has {width} numbers" if width else ""
    raise UserError(f"which robot is it? {called}{size}", hint=f"--embodiment NAME: {', '.join(fitting)}")


def _joints(robot: Embodiment) -> int:
    return sum(arm.dof + arm.ee_dim for arm in robot.arms)


def _action_type(parts: object) -> str:
    """Return the kind of control whose words an answer's parts are: poses are ee, everything else joint."""
    joint, ee = sdk.ACTION_TYPES
    kinds = {kind for part in parts for kind in part} if isinstance(parts, list) else set()
    return str(ee if kinds & {"position", "rotation"} else joint)
