"""What one checkpoint says of its model, in the terms that all makers share; `block.py` makes a manifest of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.adopt.checkpoints.layout import Numbers
    from xpl_cli.adopt.facts import Evidence, Open, Told, Tree


@dataclass(frozen=True)
class View:
    """One image input.

    Attributes:
        input: the model's name for it.
        names: what the data called its cameras, several where they are put together.
        evidence: where these names stand.
        size: height and width that the model was trained on, None where nothing says.
        steps: changes of geometry.
        rest: the other keys of an entry of `model_io.images`: channels, layout, dtype, range, mean, std, stack.
        optional: whether the model goes without it where the robot has no such camera.
    """

    input: Told
    names: Sequence[str]
    evidence: Evidence
    size: tuple[int, int] | None = None
    steps: Sequence[Tree] = ()
    rest: dict[str, Tree] = field(default_factory=dict)
    optional: bool = False


@dataclass(frozen=True)
class Vector:
    """One vector input, or the answer.

    Attributes:
        numbers: what it holds.
        input: the model's name for it; None for the answer.
        normalize: `normalize` of the block; None where nothing is said.
        pad: width of the model's vector.
        parts: its parts, where the maker's files tell them, or what makes them for a robot; else they are found by the
            names of its numbers.
    """

    numbers: Numbers
    input: Told | None = None
    normalize: Tree = None
    pad: Tree = None
    parts: Tree = None


def upstream(repository: str, license_: str) -> dict[str, str | None]:
    """Return `upstream` of a manifest: the code that runs a model; its revision is the author's to say."""
    return {"repository": f"https://github.com/{repository}", "revision": None, "license": license_}


@dataclass(frozen=True)
class Trained:
    """What was trained.

    Attributes:
        maker: whose files they are, such as `lerobot`.
        about: the model in a few words.
        family: kind of policy.
        action: the answer.
        reference: what actions are counted from.
        chunk: action steps that one call returns.
        sampling: whether the model draws random numbers.
        views: image inputs.
        states: vector inputs.
        instruction: the entry of the block, or None.
        history: the entry of the block, or None.
        extra: further keys of `model_io.action`.
        recurrent: whether the model keeps a state of its own.
        ensembling: decay of temporal ensembling.
        rate: steps a second.
        robot: what the maker calls the robot.
        upstream: the code that runs it.
        code: conversions that the block cannot say.
        exempt: for each number of an action whether it stays absolute where others are deltas; empty where grippers do.
        notes: what could not be read, and why; what would tell more.
    """

    maker: str
    about: str
    family: Told
    action: Vector
    reference: Told | Open
    chunk: Told | Open
    sampling: Told | Open
    views: Sequence[View] = ()
    states: Sequence[Vector] = ()
    instruction: dict[str, Tree] | None = None
    history: dict[str, Tree] | None = None
    extra: dict[str, Tree] = field(default_factory=dict)
    recurrent: Told | None = None
    ensembling: Told | None = None
    rate: Told | None = None
    robot: Told | None = None
    upstream: dict[str, str | None] | None = None
    code: Sequence[Told] = ()
    exempt: Sequence[bool] = ()
    notes: Sequence[str] = ()
