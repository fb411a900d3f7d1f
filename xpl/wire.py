"""The wire codec: frames of msgpack with numpy arrays, without I/O. Needs msgpack (extra `client`).

An array is a map with bin keys `{b"nd": True, b"type": dtype.str, b"kind": b"", b"shape": [...], b"data": bytes}` in C
order; numpy scalars have `b"nd": False`. Text keys are accepted when reading. Nothing is ever unpickled; object and date
types are refused both ways. Decoded arrays are read-only. Source: spec/<version>/wire.yml.
"""

from __future__ import annotations

import datetime
import math
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Optional

import numpy as np

from xpl import _spec as spec
from xpl.link import LinkError, as_array

_K = spec.ARRAY_KEYS
_ND, _TYPE, _KIND, _SHAPE, _DATA, _COMPLEX = (_K[name] for name in ("nd", "type", "kind", "shape", "data", "complex"))
_READABLE_KINDS = "biufcSUV"
_IDENTIFIERS = (
    spec.Frame.MESSAGE_ID,
    spec.Frame.EVALUATION_ID,
    spec.Frame.ACTION_CASE_ID,
    spec.Frame.TRIAL_ID,
    spec.Frame.REPEAT_INDEX,
    spec.Frame.STEP,
)


class WireError(ValueError):
    """A frame cannot be understood. `message_id` is set where it could still be read."""

    def __init__(self, message: str, message_id: Optional[str] = None) -> None:
        super().__init__(message)
        self.message_id = message_id


@dataclass(frozen=True)
class Frame:
    """One message of the wire; the fields are those of frame.schema.json."""

    message_type: str
    evaluation_id: str
    payload: dict[str, Any] = field(default_factory=dict)
    message_id: str = field(default_factory=lambda: uuid.uuid4().hex)
    action_case_id: Optional[str] = None
    trial_id: Optional[str] = None
    repeat_index: Optional[int] = None
    step: int = 0
    sent_at: str = field(default_factory=lambda: datetime.datetime.now(datetime.timezone.utc).isoformat())

    def answer(self, message_type: str, payload: dict[str, Any]) -> Frame:
        """Return an answer that repeats this request's identifiers."""
        return Frame(message_type=message_type, payload=payload, **{name: getattr(self, name) for name in _IDENTIFIERS})


def encode(frame: Frame) -> bytes:
    """Return the bytes of one frame.

    Raises:
        WireError: if the payload holds what cannot travel.
    """
    try:
        packed: bytes = _msgpack().packb(vars(frame), default=_encode_extra, use_bin_type=True)
    except (LinkError, TypeError, ValueError, OverflowError) as error:
        raise WireError(f"the {frame.message_type} payload cannot be sent: {error}", frame.message_id) from None
    return packed


def decode(data: bytes) -> Frame:
    """Return the frame of some bytes.

    Raises:
        WireError: if they are not a frame of the wire, or beyond its limits.
    """
    if len(data) > spec.LIMITS["frame_bytes"]:
        raise WireError(f"a frame of {len(data)} bytes is over the limit of {spec.LIMITS['frame_bytes']}")
    try:
        fields = _msgpack().unpackb(data, object_hook=_decode_map, raw=False, strict_map_key=False)
    except WireError:
        raise
    except Exception as error:  # noqa: BLE001 - msgpack raises many types, numpy too; all mean the same here
        raise WireError(f"the frame is not valid msgpack: {error}") from None
    return _checked(fields)


def _checked(fields: Any) -> Frame:
    if not isinstance(fields, dict):
        raise WireError(f"a frame must be a map, got {type(fields).__name__}")
    message_id = fields.get(spec.Frame.MESSAGE_ID)
    known = message_id if isinstance(message_id, str) else None
    kinds: dict[str, tuple[type, ...]] = {
        spec.Frame.MESSAGE_TYPE: (str,),
        spec.Frame.MESSAGE_ID: (str,),
        spec.Frame.EVALUATION_ID: (str,),
        spec.Frame.ACTION_CASE_ID: (str, type(None)),
        spec.Frame.TRIAL_ID: (str, type(None)),
        spec.Frame.REPEAT_INDEX: (int, type(None)),
        spec.Frame.STEP: (int,),
        spec.Frame.SENT_AT: (str,),
        spec.Frame.PAYLOAD: (dict,),
    }
    for name, allowed in kinds.items():
        value = fields.get(name)
        if not isinstance(value, allowed) or isinstance(value, bool):
            wanted = " or ".join("nil" if kind is type(None) else kind.__name__ for kind in allowed)
            raise WireError(f"frame field {name} must be {wanted}, got {type(value).__name__}", known)
    if depth(fields[spec.Frame.PAYLOAD]) > spec.LIMITS["nesting"]:
        raise WireError(f"the payload is nested deeper than {spec.LIMITS['nesting']} levels", known)
    return Frame(**{name: fields.get(name) for name in kinds})


def depth(value: Any) -> int:
    """Return how deeply maps and lists are nested in a value; 0 for a scalar."""
    level, current = 0, [value]
    while current:
        deeper = []
        for item in current:
            if isinstance(item, dict):
                deeper.extend(item.values())
            elif isinstance(item, list):
                deeper.extend(item)
        if not any(isinstance(item, (dict, list)) for item in current):
            return level
        level, current = level + 1, deeper
        if level > spec.LIMITS["nesting"]:
            return level
    return level


def _encode_extra(value: Any) -> Any:
    if isinstance(value, complex):
        return {_COMPLEX: True, _DATA: repr(value)}
    if isinstance(value, Mapping):
        return dict(value)
    array = as_array(value)
    if array.ndim == 0 and isinstance(value, np.generic):
        return {_ND: False, _TYPE: array.dtype.str, _DATA: array.tobytes()}
    structured = array.dtype.names is not None
    return {
        _ND: True,
        _TYPE: [list(entry) for entry in array.dtype.descr] if structured else array.dtype.str,
        _KIND: spec.STRUCTURED_KIND if structured else b"",
        _SHAPE: list(array.shape),
        _DATA: memoryview(array).cast("B") if array.size and array.dtype.kind in "biufc" else array.tobytes(),
    }


def _decode_map(entries: dict[Any, Any]) -> Any:
    if _ND in entries or _ND.decode() in entries:
        fields = _bin_keys(entries)
        if _DATA in fields and _TYPE in fields:
            return _array(fields)
    if _COMPLEX in entries or _COMPLEX.decode() in entries:
        fields = _bin_keys(entries)
        if isinstance(fields.get(_DATA), str):
            return complex(fields[_DATA])
    if all(type(key) is str for key in entries):
        return entries
    return {_text_key(key): value for key, value in entries.items()}


def _bin_keys(entries: dict[Any, Any]) -> dict[Any, Any]:
    return {key.encode() if isinstance(key, str) else key: value for key, value in entries.items()}


def _text_key(key: Any) -> str:
    if isinstance(key, (str, bytes)):
        return key if isinstance(key, str) else key.decode(errors="replace")
    if isinstance(key, int):
        return str(key)
    raise WireError(f"a map key must be text, got {type(key).__name__}")


def _array(fields: dict[Any, Any]) -> Any:
    dtype = _dtype(fields[_TYPE])
    data = fields[_DATA]
    if not isinstance(data, (bytes, bytearray)):
        raise WireError(f"array data must be bytes, got {type(data).__name__}")
    if not fields[_ND]:
        if len(data) != dtype.itemsize:
            raise WireError(f"a {dtype} scalar takes {dtype.itemsize} bytes, got {len(data)}")
        return np.frombuffer(data, dtype=dtype)[0]
    shape = fields.get(_SHAPE)
    if not isinstance(shape, list) or not all(type(size) is int and size >= 0 for size in shape):
        raise WireError(f"an array shape must be a list of sizes, got {shape!r}")
    if math.prod(shape) * dtype.itemsize != len(data):
        raise WireError(f"an array {shape} of {dtype} takes {math.prod(shape) * dtype.itemsize} bytes, got {len(data)}")
    return np.frombuffer(data, dtype=dtype).reshape(shape) if data else np.empty(shape, dtype=dtype)


def _dtype(description: Any) -> np.dtype[Any]:
    try:
        if isinstance(description, list):
            dtype = np.dtype([tuple(_text(part) for part in entry) for entry in description])
        else:
            dtype = np.dtype(_text(description))
    except (TypeError, ValueError) as error:
        raise WireError(f"unknown array type {description!r}: {error}") from None
    if dtype.hasobject or dtype.kind not in _READABLE_KINDS or dtype.itemsize == 0:
        raise WireError(f"arrays of type {dtype} are refused: only numbers, flags and text travel")
    return dtype


def _text(part: Any) -> Any:
    if isinstance(part, bytes):
        return part.decode()
    return tuple(part) if isinstance(part, list) else part


def _msgpack() -> Any:
    try:
        import msgpack
    except ImportError:
        raise ImportError("the wire needs msgpack: install the extra `client`") from None
    return msgpack
