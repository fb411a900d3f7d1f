"""JSON of third parties: what honest writers make is read as the standard library reads it, the rest is one error."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xpl import json_text

SCALARS = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(st.characters(codec="utf-8"))
VALUES = st.recursive(
    SCALARS, lambda inner: st.lists(inner) | st.dictionaries(st.text(st.characters(codec="utf-8")), inner)
)


@given(VALUES, st.booleans())
def test_what_python_writes_is_read_again(value: Any, ascii_only: bool) -> None:
    written = json.dumps(value, ensure_ascii=ascii_only)
    assert json_text.parse(written) == value
    assert json_text.parse(written.encode("utf-8-sig")) == value
    if "Infinity" not in written:
        assert json_text.parse(written, finite=True) == value


@given(st.binary() | st.text(st.characters()) | st.text('[]{}":,0e1+-.\\udNaIfity ').map(str.encode))
def test_anything_else_is_one_error(text: str | bytes) -> None:
    for finite in (False, True):
        try:
            value = json_text.parse(text, finite=finite)
        except json_text.JsonError:
            continue
        json.dumps(value, ensure_ascii=False, allow_nan=not finite).encode()


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("[" * 100_000, id="deep"),
        pytest.param("[" * 65 + "]" * 65, id="just too deep"),
        pytest.param('{"a":' * 65 + "1" + "}" * 65, id="deep maps"),
        pytest.param("1" * 100_000, id="long integer"),
        pytest.param('{"\\ud800": 1}', id="half of a pair"),
        pytest.param('"\ud800"', id="half of a pair, unescaped"),
        pytest.param(b"\xff\xfe[\x00]\x00", id="UTF-16"),
        pytest.param(b"", id="nothing"),
    ],
)
def test_what_would_hurt_later_is_refused(text: str | bytes) -> None:
    with pytest.raises(json_text.JsonError):
        json_text.parse(text)


def test_as_deep_as_may_be() -> None:
    assert json_text.parse("[" * 64 + "]" * 64)


@pytest.mark.parametrize("text", ["NaN", "[-Infinity]", '{"a": 1e999}'])
def test_numbers_that_json_has_not_are_refused_where_that_is_asked(text: str) -> None:
    assert any(not math.isfinite(number) for number in _numbers(json_text.parse(text)))
    with pytest.raises(json_text.JsonError, match="no finite number"):
        json_text.parse(text, finite=True)


def _numbers(value: Any) -> list[float]:
    return [value] if isinstance(value, float) else list(value.values() if isinstance(value, dict) else value)
