"""A trained model in terms that all frameworks share; `block.py` turns it into a manifest."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.adopt.checkpoints.layout import VectorNumbers
    from xpl_cli.adopt.facts import Evidence, Fact, Tree, UnknownFact


@dataclass(frozen=True)
class ImageSpec:
    """An image input.

    Attributes:
        input: the model's name for it.
        names: the dataset's names of its cameras, several where images are concatenated.
        evidence: source of these names.
        size: height and width of training images; None if unknown.
        steps: geometric transforms.
        rest: the other keys of an entry of `model_io.images`: channels, layout, dtype, range, mean, std, stack.
        optional: whether the model works without it if the robot has no such camera.
    """

    input: Fact
    names: Sequence[str]
    evidence: Evidence
    size: tuple[int, int] | None = None
    steps: Sequence[Tree] = ()
    rest: dict[str, Tree] = field(default_factory=dict)
    optional: bool = False


@dataclass(frozen=True)
class VectorSpec:
    """A vector input, or the action.

    Attributes:
        numbers: width, names and range.
        input: the model's name for it; None for the action.
        normalize: `normalize` of the block; None if unknown.
        pad: width of the model's vector.
        parts: its parts, or a function that returns them for a robot; None to derive them from the names of its
            numbers.
    """

    numbers: VectorNumbers
    input: Fact | None = None
    normalize: Tree = None
    pad: Tree = None
    parts: Tree = None


def upstream(repository: str, license_: str) -> dict[str, str | None]:
    """Return the manifest's `upstream`: the code that runs a model; the author fills in the revision."""
    return {"repository": f"https://github.com/{repository}", "revision": None, "license": license_}


@dataclass(frozen=True)
class TrainedModel:
    """A trained model.

    Attributes:
        framework: that wrote the files, such as `lerobot`.
        about: the model in a few words.
        family: kind of policy.
        action: the action vector.
        reference: what actions are relative to.
        chunk: number of actions that one call returns.
        sampling: whether the model draws random numbers.
        views: image inputs.
        states: vector inputs.
        instruction: the entry of the block, or None.
        history: the entry of the block, or None.
        extra: further keys of `model_io.action`.
        recurrent: whether the model keeps a state of its own.
        ensembling: decay of temporal ensembling.
        rate: steps per second.
        robot: the framework's name of the robot.
        upstream: the code that runs it.
        requirements: libraries that run any checkpoint of the framework, so that a complete adapter can be written.
        code: conversions that the block cannot express.
        exempt: for each number of an action whether it stays absolute where others are deltas; empty if grippers do.
        notes: what could not be read, and why.
    """

    framework: str
    about: str
    family: Fact
    action: VectorSpec
    reference: Fact | UnknownFact
    chunk: Fact | UnknownFact
    sampling: Fact | UnknownFact
    views: Sequence[ImageSpec] = ()
    states: Sequence[VectorSpec] = ()
    instruction: dict[str, Tree] | None = None
    history: dict[str, Tree] | None = None
    extra: dict[str, Tree] = field(default_factory=dict)
    recurrent: Fact | None = None
    ensembling: Fact | None = None
    rate: Fact | None = None
    robot: Fact | None = None
    upstream: dict[str, str | None] | None = None
    requirements: Sequence[str] = ()
    code: Sequence[Fact] = ()
    exempt: Sequence[bool] = ()
    notes: Sequence[str] = ()
