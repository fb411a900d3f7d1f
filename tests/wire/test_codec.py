from __future__ import annotations

import json
import math
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tests.support.checkout import ROOT
from tests.support.examples import examples
from tests.wire.messages import looped, peak, same
from xpl import _spec as spec
from xpl.wire import arrays, codec, packed
from xpl.wire.codec import Frame, WireError

VECTORS = ROOT / "conformance" / "vectors"


def vectors(name: str, key: str = "vectors") -> list[Any]:
    entries = json.loads((VECTORS / f"{name}.json").read_text(encoding="utf-8"))[key]
    return [pytest.param(entry, id=entry["name"]) for entry in entries]


def data_of(entry: dict[str, Any]) -> bytes:
    return b"".join(bytes.fromhex(piece) for piece, _ in entry["bytes"])


def meant(value: Any) -> Any:  # noqa: PLR0911 - one for each kind of value
    if isinstance(value, list):
        return [meant(item) for item in value]
    if not isinstance(value, dict):
        return value
    if "array" in value:
        array = value["array"]
        dtype = meant_dtype(array["dtype"])
        items = [meant_item(item) for item in array["items"]]
        return np.array(items, dtype=dtype).reshape(array["shape"])
    if "scalar" in value:
        return np.dtype(value["scalar"]["dtype"]).type(value["scalar"]["item"])
    if isinstance(value.get("complex"), list):
        return complex(*value["complex"])
    if "bytes" in value:
        return bytes.fromhex(value["bytes"])
    return {key: meant(item) for key, item in value.items()}


def meant_dtype(description: Any) -> np.dtype[Any]:
    if isinstance(description, str):
        return np.dtype(description)
    return np.dtype([(name, form, *map(tuple, shape)) for name, form, *shape in description])


def meant_item(item: Any) -> Any:
    return tuple(meant(part) for part in item) if isinstance(item, list) else item


def sent(value: Any) -> Any:
    return codec.decode(codec.encode(Frame("call", "e", {"obs": value}))).payload["obs"]


def raw(**changes: Any) -> bytes:
    fields = vars(Frame("infer", "e1", {}, message_id="m1"))
    return bytes(msgpack.packb({**fields, **changes}))


# -- golden vectors ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("entry", vectors("values"))
def test_values_are_written_and_read_as_the_wire_says(entry: dict[str, Any]) -> None:
    empty = codec.encode(Frame("call", "e", {}))
    decoded = codec.decode(empty[:-1] + b"\x81\xa1v" + data_of(entry)).payload["v"]
    assert same(meant(entry["value"]), decoded)
    assert codec.encode(Frame("call", "e", {"v": decoded})).endswith(b"\x81\xa1v" + data_of(entry))
    assert codec.encode(Frame("call", "e", {"v": meant(entry["value"])})).endswith(b"\x81\xa1v" + data_of(entry))


@pytest.mark.parametrize("entry", vectors("lenient"))
def test_what_peers_also_write_is_read(entry: dict[str, Any]) -> None:
    empty = codec.encode(Frame("call", "e", {}))
    assert same(meant(entry["value"]), codec.decode(empty[:-1] + b"\x81\xa1v" + data_of(entry)).payload["v"])


@pytest.mark.parametrize("entry", vectors("frames"))
def test_frames_are_written_and_read_as_the_wire_says(entry: dict[str, Any]) -> None:
    frame = Frame(**meant(entry["value"]))
    decoded = codec.decode(data_of(entry))
    assert same(vars(frame), vars(decoded))
    if not entry.get("decode_only"):
        assert codec.encode(frame) == data_of(entry)


@pytest.mark.parametrize("entry", vectors("refused"))
def test_bad_frames_are_refused_with_the_id_that_can_be_read(entry: dict[str, Any]) -> None:
    """The id lets a server answer a frame it cannot decode."""
    with pytest.raises(WireError) as refusal:
        codec.decode(data_of(entry))
    assert refusal.value.message_id == entry["message_id"]


@pytest.mark.parametrize("entry", vectors("packed"))
def test_packed_values_are_written_and_read_as_documented(entry: dict[str, Any]) -> None:
    assert same(meant(entry["value"]), packed.decode(data_of(entry)))
    assert b"".join(packed.encode(meant(entry["value"]))) == data_of(entry)


@pytest.mark.parametrize("entry", vectors("packed", "refused"))
def test_bad_packed_values_are_refused(entry: dict[str, Any]) -> None:
    with pytest.raises(packed.PackingError):
        packed.decode(data_of(entry))


# -- the envelope ------------------------------------------------------------------------------------------------------


def test_an_answer_repeats_the_identifiers() -> None:
    request = Frame("infer", "e", {}, action_case_id="c", trial_id="t", repeat_index=2, step=7)
    answer = request.answer("infer_result", {"actions": []})
    for name in ("message_id", "evaluation_id", "action_case_id", "trial_id", "repeat_index", "step"):
        assert getattr(answer, name) == getattr(request, name)
    assert (answer.message_type, answer.payload) == ("infer_result", {"actions": []})


def test_an_unreadable_frame_still_tells_all_identifiers_that_are_right() -> None:
    with pytest.raises(WireError) as refusal:
        codec.decode(raw(trial_id=5, step=3, action_case_id="c"))
    assert refusal.value.identifiers == {
        "message_id": "m1", "evaluation_id": "e1", "action_case_id": "c", "repeat_index": None, "step": 3,
    }  # fmt: skip


@pytest.mark.parametrize("field", [{"trial_id": 5}, {"step": None}, {"repeat_index": True}, {"evaluation_id": None}])
def test_an_envelope_that_peers_refuse_is_not_sent(field: dict[str, Any]) -> None:
    with pytest.raises(WireError, match=next(iter(field))):
        codec.encode(Frame(**{**vars(Frame("hello", "e")), **field}))


def test_a_frame_without_optional_identifiers_is_read() -> None:
    fields = vars(Frame("reset", "e"))
    kept = {name: fields[name] for name in fields if name not in ("action_case_id", "trial_id", "repeat_index")}
    assert codec.decode(msgpack.packb(kept)).trial_id is None


# -- values ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dtype", "data", "shape"),
    [
        ("|b1", b"\0\1\2", [3]),
        ("|b1", b"\xff", []),
        ([["flag", "|b1"], ["value", "<f4"]], b"\2" + bytes(4), [1]),
        ([["flags", "|b1", [2]], ["value", "<f4"]], b"\0\2" + bytes(4), [1]),
        ([["inner", [["flag", "|b1"]]]], b"\3", [1]),
    ],
)
def test_a_flag_is_a_byte_of_zero_or_one(dtype: Any, data: bytes, shape: list[int]) -> None:
    """Arrays count on it: another one is neither equal to true nor to false everywhere."""
    with pytest.raises(arrays.ArrayError, match="a flag in an array must be a byte of 0 or 1"):
        arrays.from_data(data, arrays.parse_dtype(dtype), shape)
    assert arrays.from_data(bytes(len(data)), arrays.parse_dtype(dtype), shape).tobytes() == bytes(len(data))


PLAIN = st.sampled_from("?bBhHiIlLqQefdFD").map(np.dtype) | st.sampled_from(
    [">f4", ">i8", "<U3", "S4", ">U2", ">c16"]
).map(np.dtype)
STRUCTURED = st.lists(st.tuples(PLAIN, st.sampled_from([(), (2,)])), min_size=1, max_size=3).flatmap(
    lambda fields: st.booleans().map(
        lambda align: np.dtype([(f"f{i}", dtype, shape) for i, (dtype, shape) in enumerate(fields)], align=align)
    )
)
ARRAYS = (PLAIN | STRUCTURED).flatmap(
    lambda dtype: st.tuples(
        hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=3).flatmap(
            lambda shape: st.binary(
                min_size=math.prod(shape) * dtype.itemsize, max_size=math.prod(shape) * dtype.itemsize
            ).map(lambda data: made(data, dtype, shape))
        ),
        st.sampled_from([np.asarray, np.asfortranarray, lambda array: array[..., ::-1] if array.ndim else array]),
    ).map(lambda drawn: drawn[1](drawn[0]))
)


def made(data: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> np.ndarray:
    array = np.zeros(shape, dtype)
    if not dtype.names and dtype.kind in "biufc" and data:
        plain = np.frombuffer(data, np.uint8) if dtype.kind != "b" else np.frombuffer(data, np.uint8) % 2
        array[...] = plain.view(dtype).reshape(shape)
    return array


@given(ARRAYS)
def test_arrays_arrive_equal_contiguous_and_read_only(array: np.ndarray) -> None:
    arrived = sent(array)
    assert arrived.shape == array.shape
    assert arrived.flags.c_contiguous
    assert not arrived.flags.writeable
    if array.dtype.names is None:
        assert arrived.dtype == array.dtype
        assert arrived.tobytes() == array.tobytes()
    else:
        assert arrived.dtype.names == array.dtype.names
        assert all(arrived[name].tobytes() == array[name].tobytes() for name in array.dtype.names)


VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text()
    | st.binary()
    | st.complex_numbers(allow_nan=False)
    | st.floats(width=32).map(np.float32)
    | st.booleans().map(np.bool_)
    | st.integers(-128, 127).map(np.int8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@given(VALUES)
def test_values_arrive_equal(value: Any) -> None:
    assert same(value, sent(value))


@pytest.mark.parametrize(
    ("value", "arrives"),
    [
        ((1, (2.5, "x")), [1, [2.5, "x"]]),
        ({1: "a", np.int64(2): "b"}, {"1": "a", "2": "b"}),
        (np.float64(0.5), 0.5),
        (np.str_("x"), "x"),
        (np.bytes_(b"y"), b"y"),
        (np.complex128(1 + 2j), np.complex128(1 + 2j)),
        (bytearray(b"ab"), b"ab"),
        (memoryview(b"ab"), b"ab"),
        (np.array([math.nan, math.inf]), np.array([math.nan, math.inf])),
        (np.zeros((2, 0), np.uint8), np.zeros((2, 0), np.uint8)),
    ],
)
def test_what_changes_on_the_way_changes_as_documented(value: Any, arrives: Any) -> None:
    got = sent(value)
    assert same(arrives, got)
    assert type(got) is type(arrives)


def test_a_float64_scalar_travels_as_a_plain_float() -> None:
    """So that decoders without numpy read it."""
    assert codec.encode(Frame("call", "e", {"v": np.float64(0.5)}))[-9:] == b"\xcb?\xe0\0\0\0\0\0\0"


class FakeTensor:
    """What is used of a torch tensor, which is too large a thing to install for a test."""

    def __init__(self, values: np.ndarray, dtype: str, device: str = "cuda") -> None:
        self.values, self.dtype, self.device = values, dtype, device

    def detach(self) -> FakeTensor:
        return self

    def cpu(self) -> FakeTensor:
        return FakeTensor(self.values, self.dtype, "cpu")

    def float(self) -> FakeTensor:
        return FakeTensor(self.values, "torch.float32", self.device)

    def numpy(self) -> np.ndarray:
        assert self.device == "cpu"
        if self.dtype == "torch.bfloat16":
            raise TypeError("Got unsupported ScalarType BFloat16")
        return self.values


@pytest.mark.parametrize("dtype", ["torch.float32", "torch.bfloat16"])
def test_tensors_arrive_as_arrays(dtype: str) -> None:
    assert same(np.ones(3, np.float32), sent(FakeTensor(np.ones(3, np.float32), dtype)))


@pytest.mark.parametrize(
    "value",
    [
        object(),
        {1, 2},
        np.array([None]),
        np.array(["2026-01-01"], "M8[D]"),
        np.timedelta64(1, "s"),
        np.zeros(1, [("t", "M8[s]")]),
        np.zeros(1, [("o", "O")]),
        np.zeros(1, [("deep", [("t", "m8[s]", (2,))])]),
        {(1, 2): 3},
        {True: 1},
        {None: 1},
        2**70,
        "\ud800",
    ],
)
def test_what_cannot_travel_is_refused_when_it_is_sent(value: Any) -> None:
    with pytest.raises(WireError, match="call"):
        codec.encode(Frame("call", "e", {"obs": value}))


def test_a_structure_that_contains_itself_is_refused() -> None:
    with pytest.raises(WireError, match="nested"):
        codec.encode(Frame("call", "e", {"obs": looped()}))


# -- limits ------------------------------------------------------------------------------------------------------------


def nested(levels: int) -> Any:
    value: Any = 0
    for level in range(levels):
        value = [value] if level % 2 else {"k": value}
    return value


def test_nesting_is_bounded_both_ways() -> None:
    most = spec.LIMITS["nesting"]
    fits = {"obs": nested(most - 1)}
    assert codec.depth(fits) == most
    assert codec.decode(codec.encode(Frame("call", "e", fits))).payload == fits
    too_deep = {"obs": nested(most)}
    with pytest.raises(WireError, match="nested deeper"):
        codec.encode(Frame("call", "e", too_deep))
    with pytest.raises(WireError, match="nested deeper") as refusal:
        codec.decode(raw(payload=too_deep))
    assert refusal.value.message_id == "m1"


@pytest.mark.parametrize("opening", [b"\x91", b"\x81\xa1k"])
def test_nesting_beyond_the_reader_is_refused_too(opening: bytes) -> None:
    with pytest.raises(WireError) as refusal:
        codec.decode(raw()[:-1] + opening * 100_000)
    assert refusal.value.message_id == "m1"


def test_frames_beyond_the_size_limit_are_refused_both_ways(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(spec.LIMITS, "frame_bytes", 1000)
    with pytest.raises(WireError, match="over the limit of 1000"):
        codec.encode(Frame("call", "e", {"obs": bytes(1000)}))
    with pytest.raises(WireError, match="over the limit of 1000"):
        codec.decode(bytes(1001))


@pytest.mark.parametrize(
    "payload",
    [
        b"\x81\xa1v\xdd\x00\x7f\xff\xff" + b"\x80" * 0x7FFFFF,  # eight million empty maps
        b"\x81\xa1v\xdd\x00\x3f\xff\xf0" + b"\x90" * 0x3FFFF0,  # four million empty lists
    ],
)
def test_a_small_frame_cannot_ask_for_much_memory(payload: bytes) -> None:
    """Empty containers take a byte on the wire and a hundred in memory: they are counted."""
    data = raw()[:-1] + payload

    def read() -> None:
        with pytest.raises(WireError):
            codec.decode(data)

    assert peak(read) < 64 * spec.LIMITS["elements"] * 2


@pytest.mark.parametrize(
    ("dtype", "shape"),
    [
        ("<f8", [2**40, 2**40]),
        ("<f8", [0, 2**62]),
        ("|V9223372036854775807", [1]),
        ("|u1", [1] * 99),
    ],
)
def test_a_declared_size_allocates_nothing(dtype: str, shape: list[int]) -> None:
    array = {b"nd": True, b"type": dtype, b"kind": b"", b"shape": shape, b"data": b"" if 0 in shape else b"\0"}
    with pytest.raises(WireError):
        codec.decode(raw(payload={"v": array}))


HOSTILE = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 5) | st.floats() | st.text(max_size=3) | st.binary(max_size=9)
    | st.sampled_from(["<f4", "|O", "<M8[s]", "f4,f4", "(2,)f4", "|V0", "?", "|S0", "float32", b"<f4", "2j", "(("]),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(
        st.sampled_from([*spec.ARRAY_KEYS, *spec.ARRAY_KEYS.values(), 3, 1.5, None, True]), inner, max_size=5
    ),
)  # fmt: skip


@settings(max_examples=examples(400))
@given(HOSTILE)
def test_hostile_values_are_refused_or_read_and_never_crash(value: Any) -> None:
    try:
        frame = codec.decode(raw(payload={"v": value}))
    except WireError as refusal:
        assert refusal.message_id == "m1"  # noqa: PT017 - either outcome is right
    else:
        codec.encode(frame)


GOOD = codec.encode(
    Frame(
        "infer",
        "evaluation",
        {"observation": {"vision": np.arange(6).reshape(2, 3), "s": np.float32(1), "t": [1, "x", None, 2j]}},
        message_id="id",
    )
)


@given(st.integers(0, len(GOOD) - 1))
def test_truncated_frames_are_refused(length: int) -> None:
    """At every length; the id is known from where it has arrived."""
    with pytest.raises(WireError) as refusal:
        codec.decode(GOOD[:length])
    complete = GOOD.index(b"message_id") + len(b"message_id") + 3
    assert refusal.value.message_id == ("id" if length >= complete else None)
