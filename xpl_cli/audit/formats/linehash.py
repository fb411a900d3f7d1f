"""The line hashes by which code scanning recognises an alert after the file was edited elsewhere.

The action that uploads SARIF computes them where they are missing, and complains about others. The hash of a line is a
polynomial of the 100 UTF-16 units that start there, without blanks and with one character per line end, modulo 2^64; a
counter distinguishes equal lines. Source: `fingerprints.ts` of github/codeql-action.
"""

from __future__ import annotations

from array import array
from collections import Counter

_WINDOW = 100
_FACTOR = 37
_MODULUS = 1 << 64
_END_OF_FILE = 0xFFFF
_LINE_END = ord("\n")
_DROP = _FACTOR**_WINDOW


def line_hashes(content: bytes) -> list[str]:
    """Return the hash of every line of a file, including the one after its last line end.

    Args:
        content: the file; UTF-8.
    """
    text = content.decode(errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    units = array("H", text.replace(" ", "").replace("\t", "").encode("utf-16-le", "surrogatepass"))
    units.append(_END_OF_FILE)
    starts = [0, *(index + 1 for index, unit in enumerate(units) if unit == _LINE_END)]
    units.extend([0] * _WINDOW)

    hash_at: dict[int, int] = dict.fromkeys(starts, 0)
    value = 0
    for place, unit in enumerate(units):
        value = value * _FACTOR + unit
        if place >= _WINDOW:
            value -= _DROP * units[place - _WINDOW]
        value %= _MODULUS
        begin = place - _WINDOW + 1
        if begin in hash_at:
            hash_at[begin] = value
    counts: Counter[int] = Counter()
    hashes = []
    for start in starts:
        counts[hash_at[start]] += 1
        hashes.append(f"{hash_at[start]:x}:{counts[hash_at[start]]}")
    return hashes
