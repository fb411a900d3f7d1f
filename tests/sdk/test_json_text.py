"""JSON of third parties: what honest writers make is read as the standard library reads it, the rest is one error."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xpl import json_text

TEXTS = st.text(st.characters(codec="utf-8"))
NUMBERS = st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False, allow_infinity=False)


def _values(scalars: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.recursive(
        st.none() | st.booleans() | TEXTS | scalars, lambda inner: st.lists(inner) | st.dictionaries(TEXTS, inner)
    )


@given(_values(st.integers() | st.floats(allow_nan=False)), st.booleans())
def test_what_python_writes_is_read_again(value: Any, ascii_only: bool) -> None:
    written = json.dumps(value, ensure_ascii=ascii_only)
    assert json_text.parse(written) == value
    assert json_text.parse(written.encode("utf-8-sig")) == value


@given(_values(NUMBERS))
def test_finite_numbers_of_64_bits_are_read_where_only_such_are(value: Any) -> None:
    assert json_text.parse(json.dumps(value), finite=True) == value


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


@given(
    st.integers(17, 400),
    st.sampled_from(["{0}", "[1, -{0}]", '{{"a":{0}.0}}', "[\n{0}e1]", "[{0}.5e3]", "1e{1}", "[0.1E+{1}]"]),
)
def test_no_large_number_is_overlooked(digits: int, form: str) -> None:
    """Texts are looked through for what may be one before each number is looked at."""
    text = form.format("9" * digits, digits)
    value = json.loads(text)
    found = [
        abs(one)
        for one in (value if isinstance(value, list) else value.values() if isinstance(value, dict) else [value])
    ]
    is_large = any(one == float("inf") or (isinstance(one, int) and one >= 2**63) for one in found)
    try:
        assert json_text.parse(text, finite=True) == value
    except json_text.JsonError:
        assert is_large
    else:
        assert not any(
            one == float("inf") or one >= 2**64 for one in found if isinstance(one, int) or one == float("inf")
        )


@pytest.mark.parametrize("text", ["NaN", "[-Infinity]", '{"a": 1e999}', "-9223372036854775809", "[1" + "0" * 400 + "]"])
def test_other_numbers_are_refused_where_that_is_asked(text: str) -> None:
    json_text.parse(text)
    with pytest.raises(json_text.JsonError, match="which"):
        json_text.parse(text, finite=True)


@pytest.mark.parametrize("text", ['{"a": 1, "a": 2}', '[{"b": {"a": 1, "\\u0061": 1}}]', '{"": 1, "": null}'])
def test_a_key_that_comes_twice_is_refused_where_readers_would_differ(text: str) -> None:
    json_text.parse(text)
    with pytest.raises(json_text.JsonError, match="twice in one map"):
        json_text.parse(text, finite=True)
