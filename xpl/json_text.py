"""Parser of untrusted JSON with limits, for every file, line and attribute of a third party."""

from __future__ import annotations

import json
import math
import re
from typing import Any

MOST_LEVELS = 64
"""Most levels of nested lists and maps."""
_LONGEST = 200
_DIGITS = 20


class JsonError(ValueError):
    """A text is no JSON, or exceeds a limit; the message is one sentence."""


class InvalidJsonError(JsonError):
    """A text is no JSON."""


def parse(text: str | bytes, *, finite: bool = False) -> Any:
    """Return the value of a JSON text.

    Args:
        text: the whole document; bytes are UTF-8, with or without a byte-order mark.
        finite: refuse NaN, infinities and numbers beyond float64, of which RFC 8259 has none and Python's reader makes
            some, integers beyond 64 bits, with which arithmetic fails later, and keys that a map has twice, of which
            one reader takes the first and another the last.

    Raises:
        InvalidJsonError: the text is no JSON, or its bytes are no UTF-8.
        JsonError: it is nested more than 64 levels deep, has an integer of too many digits or half of a surrogate
            pair, or, with `finite`, a number that is not finite or too large, or a key twice in one map.
    """
    try:
        decoded = text if isinstance(text, str) else text.decode("utf-8-sig")
        value = _strict(decoded) if finite else json.loads(decoded)  # noqa: TID251 - bounded here
    except JsonError:
        raise
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InvalidJsonError(f"it is not JSON: {str(error)[:_LONGEST]}") from None
    except RecursionError:
        raise JsonError(f"it is nested more than {MOST_LEVELS} levels deep") from None
    except ValueError:
        raise JsonError("it holds an integer with too many digits") from None
    if decoded.count("[") + decoded.count("{") > MOST_LEVELS and _is_deeper(value, MOST_LEVELS):
        raise JsonError(f"it is nested more than {MOST_LEVELS} levels deep")
    if ("\\u" in decoded or (isinstance(text, str) and not decoded.isascii())) and not _is_text(value):
        raise JsonError("it holds half of a surrogate pair, which is no text")
    return value


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise JsonError(f"it holds {text[:40]}, which is no finite number")
    return value


def _integer(text: str) -> int:
    if len(text) > _DIGITS or not -(2**63) <= int(text) < 2**64:
        raise JsonError(f"it holds {text[:40]}, which no integer of 64 bits is")
    return int(text)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in value if keys.count(key) > 1)
        raise JsonError(f"it has the key {json.dumps(twice[:40])} twice in one map")
    return value


_PLAIN = json.JSONDecoder(parse_constant=_number, object_pairs_hook=_unique)
_CHECKED = json.JSONDecoder(parse_float=_number, parse_constant=_number, parse_int=_integer, object_pairs_hook=_unique)
_LARGE = re.compile(r"(?:^|[\s:,\[])-?[0-9][0-9.]*(?:[0-9]{18}|[eE]\+?[0-9]{3})")
"""What stands in every text with a number beyond 64 bits; looking at each number takes several times as long."""


def _strict(text: str) -> Any:
    return (_CHECKED if _LARGE.search(text) else _PLAIN).decode(text)


def _is_deeper(value: object, levels: int) -> bool:
    """Tell by looking at one level after the other, which takes a tenth of the time of a recursion."""
    level = [value] if isinstance(value, (dict, list)) else []
    for _ in range(levels):
        level = [
            inner
            for outer in level
            for inner in (outer.values() if type(outer) is dict else outer)
            if type(inner) is dict or type(inner) is list
        ]
    return bool(level)


def _is_text(value: object) -> bool:
    try:
        json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        return False
    return True
