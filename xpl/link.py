"""The private link between the server's front end and a worker: a JSON header and raw buffers.

One message is `<header length: u32 little endian><header: JSON, UTF-8><buffers>`. The header is
`{"value": tree, "sizes": [n, ...]}`; in the tree an array is `{"@array": [index, dtype, shape]}`, a numpy scalar the
same with shape null, and a byte string `{"@bytes": index}`, `index` naming a buffer. A text key that starts with `@`
has it doubled. No pickle, no msgpack: a worker needs numpy and nothing else.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from xpl.arrays import Data, as_array, data_of, describe_dtype, from_data, parse_dtype

_LENGTH = struct.Struct("<I")
PREFIX_BYTES = _LENGTH.size
_ESCAPE, _ARRAY, _BYTES = "@", "@array", "@bytes"
HEADER_LIMIT = 64 * 1024 * 1024
BUFFERS_LIMIT = 8 * 1024**3
"""Bytes in all; more than any frame unpacks to. Only a stream that is out of step asks for more."""


class LinkError(ValueError):
    """A value cannot travel over the link, or what arrived is not a message of it."""


def encode(value: Any) -> list[Data]:
    """Return the pieces of one message; arrays are not copied unless they are not contiguous.

    Args:
        value: maps, lists, tuples, text, numbers, None, byte strings, numpy arrays and scalars, torch tensors.

    Raises:
        LinkError: for any other type, for arrays of objects or dates, and for more than fits.
    """
    buffers: list[Data] = []
    try:
        tree = _to_tree(value, buffers)
        header = json.dumps(
            {"value": tree, "sizes": [len(buffer) for buffer in buffers]}, separators=(",", ":")
        ).encode()
    except RecursionError:
        raise LinkError("the value contains itself, or is nested too deeply to be sent") from None
    except ValueError as error:
        raise LinkError(str(error)) from None
    if len(header) > HEADER_LIMIT:
        raise LinkError(f"lists and text of {len(header)} bytes are over the limit of {HEADER_LIMIT}: use arrays")
    return [_LENGTH.pack(len(header)), header, *buffers]


def header_length(prefix: Data) -> int:
    """Return the length of the header that follows the first `PREFIX_BYTES` bytes of a message.

    Raises:
        LinkError: if it is beyond any sensible size, so that the stream is out of step.
    """
    (length,) = _LENGTH.unpack(prefix)
    if length > HEADER_LIMIT:
        raise LinkError(
            f"a link header of {length} bytes is over the limit of {HEADER_LIMIT}: the stream is out of step"
        )
    return int(length)


def parse_header(header: Data) -> tuple[Any, list[int]]:
    """Return the tree of a header and the sizes of the buffers that follow it.

    Raises:
        LinkError: if it is not a header.
    """
    try:
        parsed = json.loads(bytes(header))
        tree, sizes = parsed["value"], parsed["sizes"]
    except (ValueError, TypeError, LookupError, RecursionError):
        raise LinkError("the link's header is not one: the stream is out of step") from None
    if not isinstance(sizes, list) or not all(type(size) is int and size >= 0 for size in sizes):
        raise LinkError(f"the link's header has no list of buffer sizes, but {sizes!r:.80}")
    if sum(sizes) > BUFFERS_LIMIT:
        raise LinkError(
            f"{sum(sizes)} bytes of buffers are over the limit of {BUFFERS_LIMIT}: the stream is out of step"
        )
    return tree, sizes


def decode(tree: Any, buffers: Sequence[Data]) -> Any:
    """Return the value of one message. Arrays are read-only views of the buffers.

    Raises:
        LinkError: if the tree and the buffers do not fit together.
    """
    try:
        return _from_tree(tree, buffers)
    except (ValueError, TypeError, LookupError, RecursionError) as error:
        raise LinkError(f"the link's header and buffers do not fit together: {error}") from None


def map_key(key: Any) -> str:
    """Return the text that a map key travels as: text itself, or a whole number written out.

    Raises:
        LinkError: for any other key.
    """
    if isinstance(key, str):
        return str(key)
    if isinstance(key, (int, np.integer)) and not isinstance(key, bool):
        return str(int(key))
    raise LinkError(f"a map key must be text, got {key!r:.80}")


def _to_tree(value: Any, buffers: list[Data]) -> Any:
    if isinstance(value, (np.str_, np.float64)):  # Python's text and numbers by another name
        return value.item()
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    if isinstance(value, Mapping):
        return {_escaped(map_key(key)): _to_tree(item, buffers) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_to_tree(item, buffers) for item in value]
    if isinstance(value, (bytes, bytearray, memoryview)):
        buffers.append(bytes(value))
        return {_BYTES: len(buffers) - 1}
    if isinstance(value, complex):
        value = np.complex128(value)
    array = as_array(value)
    buffers.append(data_of(array))
    shape = None if isinstance(value, np.generic) else array.shape
    return {_ARRAY: [len(buffers) - 1, describe_dtype(array.dtype), shape]}


def _from_tree(tree: Any, buffers: Sequence[Data]) -> Any:
    if isinstance(tree, list):
        return [_from_tree(item, buffers) for item in tree]
    if not isinstance(tree, dict):
        return tree
    if _ARRAY in tree:
        index, description, shape = tree[_ARRAY]
        array = from_data(buffers[index], parse_dtype(description), () if shape is None else shape)
        return array[()] if shape is None else array
    if _BYTES in tree:
        return bytes(buffers[tree[_BYTES]])
    return {key[1:] if key.startswith(_ESCAPE) else key: _from_tree(item, buffers) for key, item in tree.items()}


def _escaped(key: str) -> str:
    return _ESCAPE + key if key.startswith(_ESCAPE) else key
