"""The answers of an adapter's author."""

from __future__ import annotations

from dataclasses import dataclass

from xpl_cli.scaffold import kinds


@dataclass(frozen=True)
class AdapterAnswers:
    """The author's answers; recorded in the package for later updates.

    Attributes:
        name: of the package and its folder.
        embodiment: robot, by the standard's name.
        action_type: "joint" or "ee".
        chunk: number of actions that one call returns.
        family: kind of policy.
        eval_only: leave out data processing and training.
        python: version of the policy's own Python, path of an interpreter, or "" for the kind's default.
        kind: the framework that the adapter is built on.
        history: observations kept per environment.
        ensembling: decay of temporal ensembling; None for none.
        cameras: cameras that the policy reads, as in `cam_head` or `cam_head:640x480`.
        block: whether conversions are compiled from a model_io block in policy.yml, if the kind supports it.
        reference: whether to add reference.py, which runs the authors' own code.
    """

    name: str
    embodiment: str
    action_type: str
    chunk: int
    family: str
    eval_only: bool
    python: str
    kind: str = kinds.DEFAULT
    history: int = 1
    ensembling: float | None = None
    cameras: tuple[str, ...] = ()
    block: bool = False
    reference: bool = False
