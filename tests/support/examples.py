"""How many examples a property is tried with: a quarter of those that the whole run tries, in the quick one."""

from __future__ import annotations

from typing import Final

_QUARTER, _FEWEST = 4, 15
_is_quick: Final[list[bool]] = []


def are_few(quick: bool) -> None:
    """Say, before tests are collected, whether this is the quick run."""
    _is_quick[:] = [quick]


def examples(most: int) -> int:
    """Return how many examples are tried of a property that the whole run tries with `most`."""
    return max(_FEWEST, most // _QUARTER) if _is_quick == [True] else most
