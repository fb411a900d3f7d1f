"""Numbers with their nouns, and lists that are cut short, as sentences have them."""

from __future__ import annotations

from collections.abc import Sequence


def count_noun(number: int, one: str, many: str | None = None) -> str:
    """Return a number with its noun: `1 failure`, `2 failures`."""
    return f"{number} {one if number == 1 else many or f'{one}s'}"


def join_limited(names: Sequence[str], most: int) -> str:
    """Return names with commas, at most so many, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}"
