"""The private link between the server's front end and a worker: a JSON header and raw buffers.

One message is `<header length: u32 little endian><header: JSON, UTF-8><buffers>`. The header is
`{"value": tree, "sizes": [n, ...]}`; in the tree an array is `{"__array__": [index, dtype, shape]}` and a byte string
`{"__bytes__": index}`, `index` naming a buffer. No pickle, no msgpack: a worker needs numpy and nothing else.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any, Union

import numpy as np

_LENGTH = struct.Struct("<I")
_ARRAY, _BYTES = "__array__", "__bytes__"
_KINDS = "biufcSUV"
HEADER_LIMIT = 64 * 1024 * 1024

Buffer = Union[bytes, memoryview]


class LinkError(ValueError):
    """A value cannot travel over the link, or what arrived is not a message of it."""


def encode(value: Any) -> list[Buffer]:
    """Return the pieces of one message; arrays are not copied unless they are not contiguous.

    Args:
        value: maps, lists, tuples, text, numbers, None, byte strings, numpy arrays and scalars, torch tensors.

    Raises:
        LinkError: for any other type, and for arrays of objects or dates.
    """
    buffers: list[Buffer] = []
    tree = _to_tree(value, buffers)
    header = json.dumps({"value": tree, "sizes": [len(buffer) for buffer in buffers]}, separators=(",", ":")).encode()
    return [_LENGTH.pack(len(header)), header, *buffers]


def header_length(prefix: bytes) -> int:
    """Return the length of the header that follows the first four bytes of a message.

    Raises:
        LinkError: if it is beyond any sensible size, so that the stream is out of step.
    """
    (length,) = _LENGTH.unpack(prefix)
    if length > HEADER_LIMIT:
        raise LinkError(f"a link header of {length} bytes is over the limit of {HEADER_LIMIT}: the stream is out of step")
    return int(length)


def parse_header(header: bytes) -> tuple[Any, list[int]]:
    """Return the tree of a header and the sizes of the buffers that follow it."""
    parsed = json.loads(header)
    return parsed["value"], parsed["sizes"]


def decode(tree: Any, buffers: Sequence[Buffer]) -> Any:
    """Return the value of one message. Arrays are read-only views of the buffers."""
    if isinstance(tree, list):
        return [decode(item, buffers) for item in tree]
    if not isinstance(tree, dict):
        return tree
    if _ARRAY in tree:
        index, dtype, shape = tree[_ARRAY]
        array = np.frombuffer(buffers[index], dtype=np.dtype(dtype)).reshape(shape)
        array.flags.writeable = False
        return array
    if _BYTES in tree:
        return bytes(buffers[tree[_BYTES]])
    return {key: decode(item, buffers) for key, item in tree.items()}


def _to_tree(value: Any, buffers: list[Buffer]) -> Any:
    if value is None or isinstance(value, (str, bool, int, float)):
        return value.item() if isinstance(value, np.generic) else value
    if isinstance(value, Mapping):
        return {_key(key): _to_tree(item, buffers) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_to_tree(item, buffers) for item in value]
    if isinstance(value, (bytes, bytearray, memoryview)):
        buffers.append(bytes(value))
        return {_BYTES: len(buffers) - 1}
    array = as_array(value)
    # A memoryview of an empty array cannot be cast, and structured data has no buffer format.
    plain = array.dtype.kind not in "SUV" and array.size
    buffers.append(memoryview(array).cast("B") if plain else array.tobytes())
    return {_ARRAY: [len(buffers) - 1, array.dtype.str if array.dtype.names is None else array.dtype.descr, array.shape]}


def _key(key: Any) -> str:
    if isinstance(key, str) and key not in (_ARRAY, _BYTES):
        return key
    if isinstance(key, (int, np.integer)) and not isinstance(key, bool):
        return str(int(key))
    raise LinkError(f"a map key must be text, got {key!r}")


def as_array(value: Any) -> np.ndarray:
    """Return a C-contiguous array of an array, numpy scalar or torch tensor (any device; bfloat16 becomes float32).

    Raises:
        LinkError: for any other type, and for arrays of objects or dates.
    """
    if not isinstance(value, (np.ndarray, np.generic)):
        detach = getattr(value, "detach", None)
        if detach is None:
            raise LinkError(f"a {type(value).__module__}.{type(value).__name__} cannot be sent: use arrays, lists, maps, text")
        tensor = detach().cpu()
        value = (tensor.float() if "bfloat16" in str(tensor.dtype) else tensor).numpy()
    array = np.asarray(value)
    if array.dtype.kind not in _KINDS or array.dtype.hasobject:
        raise LinkError(f"an array of dtype {array.dtype} cannot be sent: use numbers, flags or text")
    # ascontiguousarray would turn a 0-d array into a 1-d one.
    return array if array.flags.c_contiguous else np.ascontiguousarray(array)
