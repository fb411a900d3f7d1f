"""Arrays as bytes: which arrays can be sent, how a dtype is written, and how bytes become an array again.

Both codecs (`xpl.wire.codec`, `xpl.process.link`) build on this. A plain dtype is written as `dtype.str`, a structured
one as `[[name, dtype], ...]`, or `[name, dtype, shape]` for a field that is an array itself. Objects and dates are
refused both ways, also inside structures: nothing is ever unpickled.
"""

from __future__ import annotations

import functools
import math
import re
from typing import Any, Union

import numpy as np

Data = Union[bytes, bytearray, memoryview]

_KINDS = "biufcSUV"
_FIELDS = 1024
# Narrower than what `np.dtype` understands: no comma-separated lists, shapes or field offsets in a string.
_NAME = re.compile(r"[<>=|]?[A-Za-z?]\w{0,15}", re.ASCII)


class ArrayError(ValueError):
    """A value is no array that can be sent, or bytes do not match the dtype and shape of an array."""


def as_array(value: object) -> np.ndarray:
    """Return a C-contiguous array of an array, numpy scalar or torch tensor (any device; bfloat16 becomes float32).

    Structured arrays lose their padding.

    Raises:
        ArrayError: the value has another type, or is an array of objects or dates.
    """
    if not isinstance(value, (np.ndarray, np.generic)):
        detach = getattr(value, "detach", None)
        if detach is None:
            kind = f"{type(value).__module__}.{type(value).__name__}"
            raise ArrayError(f"a {kind} cannot be sent: use arrays, lists, maps, text")
        tensor = detach().cpu()
        value = (tensor.float() if "bfloat16" in str(tensor.dtype) else tensor).numpy()
    array = np.asarray(value)
    check_dtype(array.dtype)
    if array.dtype.names is not None:
        array = array.astype(parse_dtype(describe_dtype(array.dtype)), copy=False)
    # ascontiguousarray would turn a 0-d array into a 1-d one.
    return array if array.flags.c_contiguous else np.ascontiguousarray(array)


def data_of(array: np.ndarray) -> Data:
    """Return the bytes of a C-contiguous array, without a copy."""
    # As unsigned bytes: buffers of text, structures and foreign byte orders have no format that all readers know.
    return array.reshape(-1).view(np.uint8).data if array.size else b""


def from_data(data: Data, dtype: np.dtype[np.generic], shape: object) -> np.ndarray:
    """Return a read-only array that is a view of some bytes.

    Args:
        data: the array's bytes in C order.
        dtype: its dtype, as `parse_dtype` returns it.
        shape: list or tuple of sizes; anything else is refused.

    Raises:
        ArrayError: the bytes are not exactly those of an array of this shape and dtype.
    """
    if not isinstance(shape, (list, tuple)) or not all(type(size) is int and size >= 0 for size in shape):
        raise ArrayError(f"an array shape must be a list of sizes, got {shape!r:.80}")
    wanted = math.prod(shape) * dtype.itemsize
    if wanted != len(data):
        raise ArrayError(f"an array {list(shape)!s:.80} of {dtype!s:.80} takes {wanted} bytes, got {len(data)}")
    try:
        array = np.ndarray(shape, dtype, data if wanted else None)
    except (ValueError, OverflowError, TypeError) as error:  # more dimensions than numpy has, for example
        raise ArrayError(f"no array has shape {list(shape)!s:.80}: {error}") from None
    array.flags.writeable = False
    if dtype.kind in "bV" and not _has_flags_only(array):
        raise ArrayError("a flag in an array must be a byte of 0 or 1: numpy counts on it")
    return array


def _has_flags_only(array: np.ndarray) -> bool:
    """Return whether each bool of an array, or of its structures, is a byte of 0 or 1."""
    if array.dtype.names is not None:
        return all(_has_flags_only(array[name]) for name in array.dtype.names)
    return array.dtype.kind != "b" or not array.size or int(array.view(np.uint8).max()) <= 1


def describe_dtype(dtype: np.dtype[Any]) -> Any:
    """Return the text or list that describes a dtype; the inverse of `parse_dtype`."""
    if dtype.names is None:
        return dtype.str
    return [[name, *_describe_field(dtype[name])] for name in dtype.names]


def parse_dtype(description: object) -> np.dtype[np.generic]:
    """Return the dtype that a text or a list describes; text may be bytes.

    Raises:
        ArrayError: it describes no dtype, or one whose arrays cannot be sent.
    """
    if isinstance(description, list):
        if len(description) > _FIELDS:
            raise ArrayError(f"a structure of {len(description)} fields is over the limit of {_FIELDS}")
        return _dtype([_parse_field(entry) for entry in description], description)
    return _named_dtype(_text(description))


@functools.lru_cache(maxsize=512)
def _named_dtype(name: str) -> np.dtype[np.generic]:
    if not _NAME.fullmatch(name):
        raise ArrayError(f"unknown array type {name!r:.80}")
    return _dtype(name, name)


def _dtype(known: Any, description: Any) -> np.dtype[np.generic]:
    try:
        dtype: np.dtype[np.generic] = np.dtype(known)
    # A warning, too, where those are errors: numpy calls some names old.
    except (TypeError, ValueError, OverflowError, DeprecationWarning) as error:
        raise ArrayError(f"unknown array type {description!r:.80}: {error}") from None
    check_dtype(dtype)
    return dtype


def _describe_field(dtype: np.dtype[np.generic]) -> list[Any]:
    if dtype.subdtype is None:
        return [describe_dtype(dtype)]
    base, shape = dtype.subdtype
    return [describe_dtype(base), list(shape)]


def _parse_field(entry: object) -> tuple[Any, ...]:
    if not isinstance(entry, list) or len(entry) not in (2, 3):
        raise ArrayError(f"a field of a structure must be [name, type] or [name, type, shape], got {entry!r:.80}")
    shape = entry[2] if len(entry) == 3 else []
    if not isinstance(shape, list) or not all(type(size) is int and size > 0 for size in shape):
        raise ArrayError(f"the shape of a structure's field must be a list of sizes, got {shape!r:.80}")
    return (_text(entry[0]), parse_dtype(entry[1]), tuple(shape))


def _text(value: object) -> str:
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    if not isinstance(value, str):
        raise ArrayError(f"an array type must be text, got {type(value).__name__}")
    return value


def check_dtype(dtype: np.dtype[np.generic]) -> None:
    """Check that arrays of a dtype can be sent.

    Raises:
        ArrayError: the dtype has objects or dates, also inside structures, elements without a size, or structures of
            very many fields.
    """
    parts, seen = [dtype], 0
    while parts:
        part = parts.pop().base
        if part.names is None:
            _check_plain(part)
            continue
        if part.itemsize == 0:
            raise ArrayError("arrays of structures without a size are refused")
        seen += len(part.names)
        if seen > _FIELDS:
            raise ArrayError(f"arrays of structures of more than {_FIELDS} fields are refused: send several arrays")
        parts.extend(part[name] for name in part.names)


@functools.lru_cache(maxsize=512)  # not structures: a peer can invent any number of them, each as large as a frame
def _check_plain(dtype: np.dtype[np.generic]) -> None:
    if dtype.kind not in _KINDS or dtype.hasobject or dtype.itemsize == 0:
        raise ArrayError(f"arrays of type {dtype!s:.80} are refused: only numbers, flags and text travel")
