"""Names that somebody who gave another one most likely meant."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable


def nearest(given: str, known: Iterable[str], most: int = 3, cutoff: float = 0.6) -> list[str]:
    """Return the names that a name is most likely a misspelling of, the likeliest first.

    Args:
        given: the name.
        known: those that there are.
        most: how many are returned at most.
        cutoff: how alike they have to be, 0 to 1 (`difflib.SequenceMatcher.ratio`); the same words in another order
            (`single_arx_x5`, `arx_x5_single`) are all alike.
    """
    by_folded = {name.casefold(): name for name in known}
    words = _words(given)
    turned = [name for name in by_folded if _words(name) == words]
    near = turned or difflib.get_close_matches(given.casefold(), by_folded, n=most, cutoff=cutoff)
    return [by_folded[name] for name in near][:most]


def _words(name: str) -> list[str]:
    return sorted(re.split(r"[\W_]+", name.casefold()))
