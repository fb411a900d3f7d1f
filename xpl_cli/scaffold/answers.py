"""What the author of an adapter chose."""

from __future__ import annotations

from dataclasses import dataclass

from xpl_cli.scaffold import kinds


@dataclass(frozen=True)
class Answers:
    """What an author chose; recorded in the package, so that the same render can be made again.

    Attributes:
        name: the package's name, which is its folder's.
        embodiment: robot, by its name in the standard.
        action_type: "joint" or "ee".
        chunk: action steps that one call returns.
        family: kind of policy.
        eval_only: leave out data processing and training.
        python: version of the policy's own Python, path of an interpreter, or "" for what its kind needs.
        kind: what the adapter is built on. This and what follows has the value here where a template does not ask.
        history: observations kept per environment.
        ensembling: decay of temporal ensembling, None for none.
        cameras: cameras that the policy reads, as in `cam_head` or `cam_head:640x480`.
        block: conversions are compiled from a model_io block in policy.yml, where the kind can have one.
        reference: a reference.py, which answers through the authors' own code.
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
