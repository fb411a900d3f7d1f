"""Comparison of a policy's answers, with descriptions of differences."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, TypeGuard

import numpy as np

from xpl.action import ActionError, check_chunk
from xpl.client import PolicyServerError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl.embodiment import Embodiment

_TOLERANCE = 1e-6
"""Actions of equal inputs may differ by this much on a CPU; rounding.py measures what batches of a GPU do."""
_LONGEST: Final = 120
"""Longest text of an error in a message, characters."""


def error_code(answer: object) -> str | None:
    """Return the wire's error code if an answer is an error, else None."""
    return answer.code if isinstance(answer, PolicyServerError) else None


def same(first: object, second: object) -> bool:
    """Tell whether two answers hold the same values, up to rounding."""
    return difference(first, second) is None


def difference(first: object, second: object, *, slack: Mapping[str, float] | None = None) -> str | None:
    """Describe where two answers first differ; None if they are equal. Two errors with the same code are equal.

    Args:
        first: the one.
        second: the other.
        slack: tolerance by key, in addition to the rounding that is always allowed.
    """
    return _difference(first, second, slack or {}, 0.0)


def _difference(first: object, second: object, slack: Mapping[str, float], allowed: float) -> str | None:
    if isinstance(first, PolicyServerError) or isinstance(second, PolicyServerError):
        return None if error_code(first) == error_code(second) else f"{brief(first)} against {brief(second)}"
    if isinstance(first, dict) and isinstance(second, dict) and first.keys() == second.keys():
        entries = [(key, first[key], second[key], slack.get(key, allowed)) for key in first]
    elif isinstance(first, (list, tuple)) and isinstance(second, (list, tuple)) and len(first) == len(second):
        entries = [(f"[{index}]", *pair, allowed) for index, pair in enumerate(zip(first, second, strict=True))]
    elif any(isinstance(value, (dict, list, tuple)) for value in (first, second)):
        return f"{brief(first)} against {brief(second)}"
    else:
        return _array_difference(first, second, allowed)
    differences = ((label, _difference(one, other, slack, tolerance)) for label, one, other, tolerance in entries)
    return next((f"{label} {what}" for label, what in differences if what), None)


def _array_difference(first: object, second: object, allowed: float) -> str | None:
    a, b = np.asarray(first), np.asarray(second)
    if a.shape != b.shape:
        return f"shape {a.shape} against {b.shape}"
    if a.dtype.kind in "biuf" and b.dtype.kind in "biuf":
        if np.allclose(a, b, rtol=_TOLERANCE, atol=_TOLERANCE + allowed, equal_nan=True):
            return None
        worst = float(np.nanmax(np.abs(a.astype(float) - b.astype(float))))
        return f"{brief(first)} against {brief(second)} (largest difference {worst:.3g})"
    return None if np.array_equal(a, b) else f"{brief(first)} against {brief(second)}"


def raised(answer: object) -> str | None:
    """Return what a policy raised, such as `KeyError: 'env_idx'`; None if an answer is no error."""
    if not isinstance(answer, PolicyServerError):
        return None
    text = " ".join(str(answer).removeprefix(f"{answer.code}: ").split())
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def is_answer_list(value: object, count: int | None = None) -> TypeGuard[Sequence[Any]]:
    """Tell whether an answer is a non-empty list (of `count` entries) and not an error."""
    return isinstance(value, (list, tuple)) and len(value) > 0 and (count is None or len(value) == count)


def describe_wrong_batch(answer: object, alone: dict[int, object], requested: Sequence[int]) -> str:
    """Describe a wrong batch answer: the environments that it answers for, and the consequence."""
    if not isinstance(answer, (list, tuple)):
        return f"gives {brief(answer)}: robots get no command"
    if len(answer) != len(requested):
        return f"gives {len(answer)} chunks: robots receive each other's commands"
    actual = [next((env for env, chunk in alone.items() if same(chunk, item)), None) for item in answer]
    if None in actual:
        return "gives other actions than when all are asked for: what a robot does depends on the others in the list"
    plural = "environment" if len(actual) == 1 else "environments"
    return f"answers for {plural} {', '.join(map(str, actual))}: robots receive each other's commands"


def structure_problem(chunk: object, embodiment: Embodiment, action_type: str) -> str | None:
    """Return the problem of a chunk's keys, dimensions or values, or None."""
    if isinstance(chunk, PolicyServerError):
        return str(chunk)
    try:
        check_chunk(chunk, embodiment, action_type)
    except ActionError as error:
        return str(error)
    return None


def shapes(chunk: object) -> str:
    """Describe keys and shapes of a chunk's first step."""
    if not is_answer_list(chunk) or not isinstance(chunk[0], dict):
        return brief(chunk)
    return ", ".join(f"{key} {np.shape(value)}" for key, value in chunk[0].items())


def first_step(chunk: object) -> dict[str, list[float]]:
    """Return the first action of a chunk as short lists, for evidence; of values that are no numbers nothing."""
    if not isinstance(chunk, (list, tuple)) or not chunk or not isinstance(chunk[0], dict):
        return {}
    arrays = {key: np.ravel(np.asarray(value)) for key, value in chunk[0].items() if not isinstance(value, (dict, str))}
    numbers = {key: array for key, array in arrays.items() if array.dtype.kind in "biuf"}
    return {key: [round(float(item), 4) for item in array] for key, array in numbers.items()}


def brief(value: object) -> str:
    """Return an answer in at most 80 characters."""
    if isinstance(value, PolicyServerError):
        return f"an error ({value.code})"
    text = (
        np.array2string(np.asarray(value), precision=4, threshold=6) if isinstance(value, np.ndarray) else repr(value)
    )
    return text if len(text) <= 80 else text[:77] + "..."
