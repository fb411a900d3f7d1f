"""openpi's messages: what its own code writes and reads, and what is refused."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from tests.support.outside import openpi as theirs
from xpl.openpi import codec
from xpl.wire.codec import WireError

LEAVES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(allow_nan=False),
    st.text(),
    arrays.arrays(
        arrays.scalar_dtypes().filter(lambda dtype: dtype.kind in "biuf"),
        arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=3),
    ),
)
VALUES = st.recursive(
    LEAVES, lambda inside: st.lists(inside, max_size=3) | st.dictionaries(st.text(), inside, max_size=3), max_leaves=6
)


@given(VALUES)
def test_both_codecs_read_what_the_other_writes(value: Any) -> None:
    _assert_same(theirs.unpack(codec.pack(value)), value)
    _assert_same(codec.unpack(theirs.pack(value)), value)


def test_scalars_of_numpy_travel_as_openpi_writes_them() -> None:
    for value in (np.float32(0.5), np.uint8(7), np.bool_(True)):
        for got in (theirs.unpack(codec.pack(value)), codec.unpack(theirs.pack(value))):
            assert (type(got), got) == (type(value), value)


def _assert_same(got: Any, sent: Any) -> None:
    if isinstance(sent, np.ndarray):
        assert (got.dtype, got.shape, got.tobytes()) == (sent.dtype, sent.shape, sent.tobytes())
    elif isinstance(sent, dict):
        assert got.keys() == sent.keys()
        for key, value in sent.items():
            _assert_same(got[key], value)
    elif isinstance(sent, list):
        assert len(got) == len(sent)
        for one, other in zip(got, sent, strict=True):
            _assert_same(one, other)
    else:
        assert (type(got), got) == (type(sent), sent)


def _array(**changed: Any) -> bytes:
    fields = {"__ndarray__": True, "data": bytes(12), "dtype": "<f4", "shape": [3], **changed}
    packed: bytes = msgpack.packb({key.encode(): value for key, value in fields.items()})
    return packed


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (_array(dtype="|O"), "arrays of type object are refused"),
        (_array(dtype="<M8[s]"), "unknown array type"),
        (_array(dtype=None), "an array type must be text"),
        (_array(shape=[4]), "takes 16 bytes, got 12"),
        (_array(shape=[2**40, 2**40]), "bytes, got 12"),
        (_array(shape=None), "a list of sizes"),
        (_array(data="text"), "array data must be bytes"),
        (msgpack.packb({b"__npgeneric__": True, b"data": [1], b"dtype": "<f4"}), "a scalar must be"),
        (msgpack.packb({b"__npgeneric__": True, b"data": 300, b"dtype": "|u1"}), "300 is no uint8"),
        (msgpack.packb({b"__npgeneric__": True, b"data": 3, b"dtype": "|O"}), "refused"),
        (msgpack.packb(msgpack.ExtType(5, b"")), "extension type 5"),
        (b"\x81" * 600 + b"\xc0", "not valid msgpack"),
        (b"\x91" * 40 + b"\xc0", "nested deeper than 32"),
        (b"\xdd\xff\xff\xff\xff", "not valid msgpack"),
        (b"", "not valid msgpack"),
    ],
)
def test_what_is_damaged_or_unsafe_is_refused(data: bytes, told: str) -> None:
    with pytest.raises(WireError, match=told):
        codec.unpack(data)


@given(st.binary(max_size=64))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    try:
        codec.unpack(data)
    except WireError:
        return


@pytest.mark.parametrize(
    "value", [object(), np.array([object()]), np.array([1j]), np.zeros(1, [("a", "<f4")]), {"a": {1, 2}}, 2**70]
)
def test_what_openpi_has_no_form_for_is_not_sent(value: Any) -> None:
    with pytest.raises(WireError, match="cannot be sent to openpi"):
        codec.pack(value)
