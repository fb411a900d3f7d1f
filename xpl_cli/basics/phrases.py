"""Phrases for sentences: numbers with nouns, and shortened lists."""

from __future__ import annotations

from collections.abc import Sequence


def count_noun(number: int, one: str, many: str | None = None) -> str:
    """Return a number with its noun: `1 failure`, `2 failures`."""
    return f"{number} {one if number == 1 else many or f'{one}s'}"


def join_limited(names: Sequence[str], most: int) -> str:
    """Return at most `most` names with commas, and the number of further ones."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}"
