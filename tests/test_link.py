from __future__ import annotations

import contextlib
import json
import math
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from xpl import link
from xpl.link import LinkError


def parse(message: bytes) -> Any:
    """Read one whole message, as a worker reads it from its socket."""
    if len(message) < link.PREFIX_BYTES:
        raise LinkError("too short")
    end = link.PREFIX_BYTES + link.header_length(message[: link.PREFIX_BYTES])
    tree, sizes = link.parse_header(message[link.PREFIX_BYTES : end])
    buffers = []
    for size in sizes:
        buffers.append(memoryview(message)[end : end + size])
        end += size
    return link.decode(tree, buffers)


def sent(value: Any) -> Any:
    """Return what arrives at the other side."""
    return parse(b"".join(link.encode(value)))


def test_structured_arrays_survive_the_json_header() -> None:
    """JSON makes lists of tuples, and a dtype wants tuples; padding is dropped, everything else is kept."""
    dtype = np.dtype([("a", "i1"), ("b", [("c", ">f4", (2,))]), ("d", "<U2")], align=True)
    array = np.zeros((2, 1), dtype)
    array["a"], array["b"]["c"], array["d"] = 3, [1.5, -2.5], "né"
    arrived = sent(array)
    assert arrived.shape == (2, 1)
    assert arrived.dtype == np.dtype([("a", "i1"), ("b", [("c", ">f4", (2,))]), ("d", "<U2")])
    assert str(arrived) == str(array)


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6, dtype=">f8").reshape(2, 3),
        np.asfortranarray(np.arange(6).reshape(2, 3)),
        np.arange(12)[::-2],
        np.zeros((0, 3), np.float32),
        np.array(5),
        np.array([True, False]),
        np.array(["é", "abc"]),
        np.array([b"a", b"bc"]),
        np.array([1 + 2j]),
        np.array([math.nan], np.float16),
    ],
    ids=lambda array: f"{array.dtype.str}{array.shape}",
)
def test_arrays_arrive_equal_and_read_only(array: np.ndarray) -> None:
    """Of any order, byte order and shape."""
    arrived = sent(array)
    assert (arrived.dtype, arrived.shape) == (array.dtype, array.shape)
    assert arrived.tobytes() == array.tobytes()
    assert not arrived.flags.writeable


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text() | st.sampled_from(["@", "@array", "@@bytes"]), inner, max_size=4)
    ),
    max_leaves=12,
)


@given(VALUES)
def test_values_arrive_equal(value: Any) -> None:
    """Every text can be a key, also those that the link uses itself."""
    assert sent(value) == value


@pytest.mark.parametrize(
    ("value", "arrives"),
    [
        ((1, (2,)), [1, [2]]),
        ({1: "a"}, {"1": "a"}),
        (np.float64(0.5), 0.5),
        (np.str_("x"), "x"),
        (np.float32(0.5), np.float32(0.5)),
        (np.bool_(True), np.bool_(True)),
        (2j, np.complex128(2j)),
        (bytearray(b"ab"), b"ab"),
    ],
)
def test_what_changes_on_the_way_changes_as_documented(value: Any, arrives: Any) -> None:
    """Numpy scalars stay scalars, so that a result is the same with and without a worker."""
    got = sent(value)
    assert got == arrives
    assert type(got) is type(arrives)


def test_nan_and_infinity_survive() -> None:
    """JSON has no words for them; Python's dialect has."""
    got = sent([math.nan, math.inf, -math.inf])
    assert math.isnan(got[0])
    assert got[1:] == [math.inf, -math.inf]


def test_contiguous_arrays_are_not_copied() -> None:
    """The pieces are views; what is decoded is a view, too."""
    array = np.arange(1000)
    *_, piece = link.encode(array)
    assert np.shares_memory(np.frombuffer(piece, np.uint8), array)


def looped() -> list[Any]:
    """Return a list that contains itself."""
    loop: list[Any] = []
    loop.append(loop)
    return loop


@pytest.mark.parametrize(
    "value",
    [object(), {1, 2}, np.array([None]), np.array(["2026"], "M8[D]"), np.zeros(1, [("t", "m8[s]")]),
     {(1,): 2}, {None: 1}, looped(), 10**5000],
    ids=["object", "set", "objects", "dates", "dates inside", "tuple key", "nil key", "loop", "huge number"],
)  # fmt: skip
def test_what_cannot_travel_is_a_link_error(value: Any) -> None:
    """Never a RecursionError or a TypeError, which would end the worker."""
    with pytest.raises(LinkError):
        link.encode(value)


def test_a_header_beyond_the_limit_is_not_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    """The other side would take it for a stream that is out of step."""
    monkeypatch.setattr(link, "HEADER_LIMIT", 100)
    with pytest.raises(LinkError, match="use arrays"):
        link.encode(list(range(100)))


def header(value: Any, sizes: Any, *buffers: bytes) -> bytes:
    """Return a message with a header of our own making."""
    text = json.dumps({"value": value, "sizes": sizes}).encode()
    return b"".join([len(text).to_bytes(4, "little"), text, *buffers])


@pytest.mark.parametrize(
    "message",
    [
        b"\xff\xff\xff\xff",
        b"\x02\0\0\0[]",
        b"\x02\0\0\0{}",
        b"\x03\0\0\0\xff\xfe\xfd",
        header(0, [-1]),
        header(0, [True]),
        header(0, 5),
        header(0, [2**60]),
        header({"@array": [0, "<f4", [2]]}, [4], b"1234"),
        header({"@array": [3, "<f4", [1]]}, [4], b"1234"),
        header({"@array": [0, "|O", [1]]}, [8], b"12345678"),
        header({"@array": [0, [["t", "<M8[s]"]], [1]]}, [8], b"12345678"),
        header({"@array": [0, "<f4", [-1]]}, [4], b"1234"),
        header({"@array": 0}, [4], b"1234"),
        header({"@bytes": "x"}, [4], b"1234"),
    ],
)
def test_a_stream_out_of_step_is_a_link_error(message: bytes) -> None:
    """Before anything of the declared size is allocated."""
    tracemalloc.start()
    with pytest.raises(LinkError):
        parse(message)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1_000_000


@settings(max_examples=300)
@given(st.data())
def test_corrupt_messages_raise_nothing_else(data: st.DataObject) -> None:
    """Decoded or refused."""
    good = bytearray(
        b"".join(link.encode({"a": np.arange(3), "b": [b"xy", 1.5, "z"], "@array": np.zeros(1, [("f", "i4")])}))
    )
    for _ in range(data.draw(st.integers(1, 4))):
        good[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(LinkError):
        parse(bytes(good))


@given(hnp.arrays(st.sampled_from([np.uint8, np.float32, np.int64]), hnp.array_shapes(min_dims=0, min_side=0)))
def test_any_shape_arrives(array: np.ndarray) -> None:
    """From no dimension on."""
    arrived = sent({"deep": [array]})["deep"][0]
    assert arrived.shape == array.shape
    assert arrived.tobytes() == array.tobytes()
