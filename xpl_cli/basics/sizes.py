"""Parse and format sizes in bytes."""

from __future__ import annotations

import re

from xpl_cli.basics.errors import UserError

_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(i?)B?", re.IGNORECASE)
_MOST_DIGITS = 18
_POWERS = {"": 0, "K": 1, "M": 2, "G": 3, "T": 4}
_UNITS = (("T", 4), ("G", 3), ("M", 2), ("k", 1))


def parse_size(text: str, option: str) -> int:
    """Parse a size such as `500MB`, `20GiB` or `4096`, bytes.

    Args:
        text: the size.
        option: name of the option, for the error.

    Raises:
        UserError: if it is malformed.
    """
    size = size_of(text)
    if size is None:
        raise UserError(f"{option} takes a size such as 500MB, 20GiB or a number of bytes, got {text[:80]!r}")
    return size


def size_of(text: str) -> int | None:
    """Return the number of bytes that a text stands for; None if it is malformed."""
    match = _SIZE.fullmatch(text.strip())
    if match is None or len(match[1]) > _MOST_DIGITS:
        return None
    number, unit, binary = match.groups()
    base = 1024 if binary else 1000
    return int(float(number) * float(base ** _POWERS[unit.upper()]))


def format_size(size: int) -> str:
    """Format a number of bytes, such as 8.2 GB."""
    unit, power = next(((name, power) for name, power in _UNITS if size >= 1000**power), _UNITS[-1])
    return f"{size / 1000**power:.3g} {unit}B"
