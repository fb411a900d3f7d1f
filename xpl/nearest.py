"""Suggestions for misspelt names."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable


def nearest(name: str, candidates: Iterable[str], most: int = 3, cutoff: float = 0.6) -> list[str]:
    """Return the names that a name is most likely a misspelling of, the likeliest first.

    Args:
        name: the misspelt name.
        candidates: the valid names.
        most: largest number of suggestions.
        cutoff: least similarity, 0..1 (`difflib.SequenceMatcher.ratio`); names of the same words in another order
            (`single_arx_x5`, `arx_x5_single`) always match.

    Returns:
        At most `most` of the candidates.
    """
    by_folded = {name.casefold(): name for name in candidates}
    words = _words(name)
    turned = [name for name in by_folded if _words(name) == words]
    near = turned or difflib.get_close_matches(name.casefold(), by_folded, n=most, cutoff=cutoff)
    return [by_folded[name] for name in near][:most]


def _words(name: str) -> list[str]:
    return sorted(re.split(r"[\W_]+", name.casefold()))
