"""Changes of encoded texts: the instruction within a prompt, and what stands around it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Callable

from xpl.observation import get_instruction
from xpl.worker.encoded.walk import UnfitError, changed

if TYPE_CHECKING:
    from xpl.contract import Entry, Observation

_DONE: tuple[Callable[[str], str], ...] = (
    str,
    lambda text: text.strip(" "),
    str.strip,
    lambda text: text.strip(". "),
    str.lower,
    lambda text: text.strip().lower(),
    lambda text: text.strip(". ").lower(),
    lambda text: text.replace(" ", "_"),
    str.upper,
)
"""What adapters do to an instruction."""


def text(value: object, how: Entry, obs: Observation) -> Any:
    """Return encoded inputs whose texts have the instruction otherwise.

    Args:
        value: encoded inputs.
        how: `case`, `strip`, and perhaps `template`, as in a model_io block; without a template the text around the
            instruction stays.
        obs: the observation.

    Raises:
        UnfitError: if there is no text.
    """
    said = get_instruction(obs) or ""
    wanted = said.strip(how["strip"]) if how.get("strip") else said
    wanted = wanted.lower() if how.get("case") == "lower" else wanted
    seen = False

    def change(leaf: object) -> Any:
        nonlocal seen
        if not isinstance(leaf, str):
            return None
        seen = True
        if "template" in how:
            return how["template"].replace("{instruction}", wanted)
        done = max((one(said) for one in _DONE if one(said) in leaf), key=len, default="")
        return leaf.replace(done, wanted) if done else wanted

    result = changed(value, change)
    if not seen:
        raise UnfitError("no text")
    return result
