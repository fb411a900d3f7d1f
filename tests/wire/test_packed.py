from __future__ import annotations

import contextlib
import json
import math
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tests.support.examples import examples
from tests.wire.messages import framed, looped, peak, same
from xpl import _spec as spec
from xpl.wire import codec, packed, process_frame
from xpl.wire.packed import PackingError


def joined(value: Any) -> bytes:
    return b"".join(packed.encode(value))


def sent(value: Any) -> Any:
    return packed.decode(joined(value))


def arrays_of(value: Any) -> Iterator[np.ndarray]:
    if isinstance(value, np.ndarray):
        yield value
    for item in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from arrays_of(item)


# -- there and back ----------------------------------------------------------------------------------------------------

TEXT = st.text(st.characters(exclude_categories=["Cs"]))
PLAIN = st.none() | st.booleans() | st.integers() | st.floats() | TEXT | st.binary()
PLAIN_DTYPES = (
    hnp.boolean_dtypes()
    | hnp.integer_dtypes()
    | hnp.unsigned_integer_dtypes()
    | hnp.floating_dtypes(sizes=(16, 32, 64))
    | hnp.complex_number_dtypes(sizes=(64, 128))
    | hnp.byte_string_dtypes()
    | hnp.unicode_string_dtypes(max_len=4)
)
STRUCTURES = hnp.array_dtypes(PLAIN_DTYPES, max_size=3, allow_subarrays=True)
# A title is a second name of a field; it does not travel.
DTYPES = PLAIN_DTYPES | STRUCTURES.filter(lambda dtype: all(len(field) == 2 for field in (dtype.fields or {}).values()))
ARRAYS = DTYPES.flatmap(
    lambda dtype: hnp.arrays(dtype, hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4))
)
KEYS = TEXT | st.sampled_from(["@", "@array", "@@bytes", "@rows", "@shared"])


@st.composite
def action_chunks(draw: st.DrawFn) -> list[dict[str, np.ndarray]]:
    kinds = draw(st.dictionaries(KEYS, st.tuples(PLAIN_DTYPES, hnp.array_shapes(max_dims=2)), min_size=1, max_size=3))
    steps = draw(st.integers(0, 4))
    chunk = [{key: draw(hnp.arrays(dtype, shape)) for key, (dtype, shape) in kinds.items()} for _ in range(steps)]
    if chunk and draw(st.booleans()):
        chunk[-1][next(iter(kinds))] = draw(ARRAYS)
    return chunk


VALUES = st.recursive(
    PLAIN | ARRAYS | action_chunks(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=4),
    max_leaves=12,
)


@given(VALUES)
@example([{"@array": np.arange(3)}, {"@array": np.arange(3)}])
@example([{"a": np.arange(3)}, {"a": np.arange(3.0)}])
@example([{"a": np.array(1)}, {"a": np.array(2)}])
@example([{"a": np.zeros((0, 2))}, {"a": np.zeros((0, 2))}])
def test_values_arrive_the_same_in_read_only_aligned_views_of_the_message(value: Any) -> None:
    whole = joined(value)
    base, arrived = np.frombuffer(whole, np.uint8), packed.decode(whole)
    assert same(arrived, value)
    for array in arrays_of(arrived):
        assert not array.flags.writeable
        assert array.flags.aligned
        if array.size:
            assert np.shares_memory(array, base)
            assert array.ctypes.data % np.gcd(array.dtype.itemsize, 16) == 0


@pytest.mark.parametrize("value", ["\ud800", {"\udfff": 1}, [{"a": np.arange(3), "b\udc80": np.arange(3)}] * 2])
def test_text_that_is_no_unicode_is_refused(value: Any) -> None:
    """Both ways, as by every other encoder: a lone surrogate would reach a peer that cannot pass it on."""
    with pytest.raises(packed.PackingError, match="surrogates not allowed"):
        packed.encode({"text": value})
    tree = json.dumps("\ud83d \udc80").encode()
    with pytest.raises(packed.PackingError, match="surrogates not allowed"):
        packed.decode(struct.pack("<4sIQ", b"XPL1", len(tree), 0) + tree)
    assert packed.decode(joined("\U0001f480")) == "\U0001f480"


def test_arrays_of_a_message_begin_at_multiples_of_16_bytes() -> None:
    arrays = {"a": np.zeros(3, np.uint8), "b": np.arange(5.0), "c": np.zeros(5000, np.int8), "d": np.ones(2, "c16")}
    for array in sent({"x": b"1", "y": {"z": b"123"}, **arrays}).values():
        assert not isinstance(array, np.ndarray) or array.ctypes.data % 16 == 0


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6, dtype=">f8").reshape(2, 3),
        np.asfortranarray(np.arange(6).reshape(2, 3)),
        np.arange(12)[::-2],
        np.arange(40_000.0)[::2],
        np.broadcast_to(np.arange(3), (4, 3)),
        np.array(5),
        np.array(["é", "abc"]),
        np.array([math.nan], np.float16),
        np.arange(5).view(np.recarray),
    ],
    ids=lambda array: f"{array.dtype.str}{array.shape}",
)
def test_arrays_of_any_layout_arrive_in_c_order(array: np.ndarray) -> None:
    arrived = sent(array)
    assert type(arrived) is np.ndarray
    assert (arrived.dtype, arrived.shape) == (array.dtype, array.shape)
    assert arrived.tobytes() == array.tobytes()
    assert arrived.flags.c_contiguous


def test_structures_lose_their_padding_only() -> None:
    """JSON makes lists of tuples, and a dtype wants tuples."""
    dtype = np.dtype([("a", "i1"), ("b", [("c", ">f4", (2,))]), ("d", "<U2")], align=True)
    array = np.zeros((2, 1), dtype)
    array["a"], array["b"]["c"], array["d"] = 3, [1.5, -2.5], "né"
    arrived = sent(array)
    assert arrived.shape == (2, 1)
    assert arrived.dtype == np.dtype([("a", "i1"), ("b", [("c", ">f4", (2,))]), ("d", "<U2")])
    assert str(arrived) == str(array)


@pytest.mark.parametrize(
    ("value", "arrives"),
    [
        ((1, (2,)), [1, [2]]),
        ({1: "a", np.int8(-2): "b"}, {"1": "a", "-2": "b"}),
        (np.float64(0.5), 0.5),
        (np.str_("x"), "x"),
        (np.float32(0.5), np.float32(0.5)),
        (np.bool_(True), np.bool_(True)),
        (2j, np.complex128(2j)),
        (bytearray(b"ab"), b"ab"),
        (memoryview(np.arange(2, dtype=np.uint16)), b"\0\0\1\0"),
    ],
)
def test_what_changes_on_the_way_changes_as_documented(value: Any, arrives: Any) -> None:
    """Numpy scalars stay scalars, so that a result is the same with and without a worker."""
    assert same(sent(value), arrives)


def test_steps_of_a_chunk_cost_one_entry_together() -> None:
    chunk = [{"arm": np.full(7, step, np.float32), "gripper": np.full(1, step, np.float32)} for step in range(50)]
    pieces = packed.encode(chunk)
    assert len(pieces) <= 5
    assert len(pieces[0]) < 200
    assert same(packed.decode(b"".join(pieces)), chunk)


# -- what is not copied, and what may lie elsewhere --------------------------------------------------------------------


def test_large_contiguous_arrays_are_not_copied() -> None:
    array = np.arange(100_000)
    image = np.zeros((1000, 10, 3), np.uint8)[100:900]
    pieces: list[Any] = []
    assert peak(lambda: pieces.extend(packed.encode({"a": [array, {"image": image}]}))) < 20_000
    for given_array in (array, image):
        assert any(np.shares_memory(np.frombuffer(piece, np.uint8), given_array) for piece in pieces)


def test_small_arrays_are_copied_before_encode_returns() -> None:
    """A message waits to be sent while its sender goes on with its buffers."""
    array = np.zeros(8)
    pieces = packed.encode([array])
    array[:] = 1
    assert packed.decode(b"".join(pieces))[0].tolist() == [0] * 8


def test_large_arrays_may_lie_in_shared_memory() -> None:
    threshold = spec.LIMITS["shared_array"]
    shelf: list[np.ndarray] = []

    def place(array: np.ndarray) -> tuple[int, int] | None:
        if len(shelf) == 2:
            return None
        shelf.append(array.copy())
        return len(shelf) - 1, 64 * len(shelf)

    def find(block: int, offset: int, dtype: np.dtype[Any], shape: Any) -> np.ndarray:
        assert offset == 64 * (block + 1)
        return shelf[block].view(dtype).reshape(shape)

    value = {
        "small": np.zeros(threshold - 1, np.uint8), "large": np.arange(threshold, dtype=np.uint8),
        "strided": np.arange(threshold, dtype=">i4").reshape(4, -1).T, "third": np.ones(threshold),
    }  # fmt: skip
    whole = b"".join(packed.encode(value, place))
    assert [array.nbytes for array in shelf] == [threshold, 4 * threshold]
    assert len(whole) < threshold + 8 * threshold + 1000
    assert same(packed.decode(whole, find), value)
    with pytest.raises(PackingError, match="agreed on none"):
        packed.decode(whole)


def test_packed_entries_of_a_frame_arrive_among_the_others() -> None:
    """Whatever their size: msgpack announces byte strings in three ways."""
    for size in (1, 100, 10_000, 100_000):
        pieces = packed.encode({"obs": {"image": np.arange(size) % 251}})
        frame = codec.decode(codec.encode(codec.Frame("call", "e", {"func_name": "f"}), pieces))
        assert same(codec.unpacked(frame.payload), {"func_name": "f", "obs": {"image": np.arange(size) % 251}})
    assert codec.unpacked({"a": 1}) == {"a": 1}


@pytest.mark.parametrize("entry", ["text", 3, b"", b"XPL1", joined([1]), joined({})[:-1]])
def test_packed_entries_that_are_none_are_refused(entry: Any) -> None:
    with pytest.raises(PackingError):
        codec.unpacked({spec.Payload.PACKED: entry})


# -- what cannot travel ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "value",
    [object(), {1, 2}, np.array([None]), np.array(["2026"], "M8[D]"), np.zeros(1, [("t", "m8[s]")]),
     {(1,): 2}, {None: 1}, {True: 1}, {b"a": 1}, looped(), 10**5000, [{"a": np.array([None])}] * 2],
    ids=["object", "set", "objects", "dates", "dates inside", "tuple key", "nil key", "flag key", "bytes key", "loop",
         "huge number", "rows of objects"],
)  # fmt: skip
def test_what_cannot_travel_is_a_packing_error(value: Any) -> None:
    with pytest.raises(PackingError):
        packed.encode({"a": [value]})


def test_a_header_beyond_the_limit_is_not_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_frame, "HEADER_LIMIT", 100)
    with pytest.raises(PackingError, match="use arrays"):
        packed.encode(list(range(100)))


# -- what is refused ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("prefix", "says"),
    [
        (b"", "begins with 16 bytes"),
        (b"XPL1" + bytes(11), "begins with 16 bytes"),
        (b"XPL2" + bytes(12), "out of step"),
        (struct.pack("<4sIQ", b"XPL1", process_frame.HEADER_LIMIT + 1, 0), "over the limits"),
        (struct.pack("<4sIQ", b"XPL1", 0, process_frame.BODY_LIMIT + 1), "over the limits"),
        (struct.pack("<4sIQ", b"XPL1", 2**32 - 1, 2**64 - 1), "over the limits"),
    ],
)
def test_a_prefix_that_is_none_is_refused(prefix: bytes, says: str) -> None:
    with pytest.raises(PackingError, match=says):
        packed.lengths(prefix)
    with pytest.raises(PackingError):
        packed.decode(prefix)


def test_a_message_that_is_not_whole_is_refused() -> None:
    whole = joined({"a": np.arange(3)})
    for data in (whole[:-1], whole + b"\0", whole[:16]):
        with pytest.raises(PackingError, match="was announced"):
            packed.decode(data)


@pytest.mark.parametrize(
    "data",
    [
        framed(b""),
        framed(b"{}{}"),
        framed(b"\xff\xfe"),
        framed(b"9" * 10_000),
        framed(b"[" * 20_000 + b"]" * 20_000),
        framed(b'{"a":' * 20_000 + b"1" + b"}" * 20_000),
        framed({"@array": [0, "<f4", [2]]}, b"1234"),
        framed({"@array": [3, "<f4", [1]]}, b"1234"),
        framed({"@array": [-1, "<f4", [1]]}, b"12345"),
        framed({"@array": [True, "|i1", [1]]}, b"12"),
        framed({"@array": [0.0, "|i1", [1]]}, b"1"),
        framed({"@array": [0, "|O", [1]]}, b"12345678"),
        framed({"@array": [0, [["t", "<M8[s]"]], [1]]}, b"12345678"),
        framed({"@array": [0, "<f4", [-1]]}, b"1234"),
        framed({"@array": [0, "<f4", [True]]}, b"1234"),
        framed({"@array": [0, "<f4", [1] * 100]}, b"1234"),
        framed({"@array": [0, "<f4", [2**70, 0]]}, b"1234"),
        framed({"@array": [0, "|i1", [2**63, 2]]}, b"1234"),
        framed({"@array": [0, "<f4"]}, b"1234"),
        framed({"@array": 0}, b"1234"),
        framed({"@array": None}),
        framed([{"@array": [8, "|u1", [8]]}, {"@array": [0, "|u1", [8]]}], bytes(16)),
        framed([{"@array": [0, "|u1", [8]]}, {"@array": [7, "|u1", [8]]}], bytes(16)),
        framed({"@bytes": "x"}, b"1234"),
        framed({"@bytes": [0, 5]}, b"1234"),
        framed({"@bytes": [0, -1]}, b"1234"),
        framed({"@bytes": [2**80, 2**80]}, b"1234"),
        framed({"@shared": [0, 0, "|u1", [1]]}),
        framed({"@rows": {}}),
        framed({"@rows": []}),
        framed({"@rows": {"a": [0, "|u1", [4]], "b": [0, "|u1", [3]]}}, b"1234"),
        framed({"@rows": {"a": [0, "|u1", []]}}, b"1234"),
        *(framed({"@rows": {"a": [0, "|u1", shape]}}) for shape in ([10**9, 0], [2**40, 0, 3], [10**9])),
        framed({"@rows": {"a": [0, "|u1", [5_000_000, 1]]}}, bytes(5_000_000)),  # more rows than a message may hold
    ],
    ids=lambda data: repr(data[16:56]),
)
def test_header_and_body_that_do_not_fit_are_refused(data: bytes) -> None:
    def read() -> None:
        with pytest.raises(PackingError):
            packed.decode(data)

    assert peak(read) < 4 << 20


def reshaped(data: st.DataObject) -> bytes:
    numbers = st.integers(-2, 40) | st.sampled_from([2**31, 2**63, 2**64, True, None, 1.5])
    dtypes = st.sampled_from(["|u1", "<f4", "<U3", "|V0", "|O", "<M8[s]", "f4,f4", [["a", "<f4"]], [["a", "<f4", [2]]]])
    entries = st.lists(numbers | dtypes | st.lists(numbers, max_size=3), max_size=5)
    marks = st.sampled_from(["@array", "@bytes", "@shared", "@rows", "@", "a"])
    tree = st.dictionaries(marks, entries | st.dictionaries(marks, entries, max_size=2), max_size=2)
    return framed(data.draw(tree | st.lists(tree, max_size=3)), bytes(32))


@settings(max_examples=examples(300))
@given(data=st.data())
def test_headers_that_mean_nothing_are_read_or_refused(data: st.DataObject) -> None:
    with contextlib.suppress(PackingError):
        packed.decode(reshaped(data))
