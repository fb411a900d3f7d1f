"""The frame of values and messages between xpl's own processes: a JSON header and raw buffers.

    <"XPL1"><header length: u32><body length: u64>   little endian
    <header: JSON, UTF-8, padded with spaces>
    <body: buffers in the order of the header, each at a multiple of 16 bytes>

The writer defines the content of the header: `xpl.wire.packed` for a value, `xpl.process.link` for a message. Standard
library only.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from xpl.wire.arrays import Data

_PREFIX = struct.Struct("<4sIQ")
PREFIX_BYTES = _PREFIX.size
_MAGIC = b"XPL1"
_ALIGN = 16
_ZEROS = bytes(_ALIGN)
HEADER_LIMIT = 64 * 1024 * 1024
BODY_LIMIT = 8 * 1024**3
"""Bytes, more than any frame unpacks to. A longer body is announced only if the stream is out of step."""


class PackingError(ValueError):
    """A value or a message cannot be packed, or received bytes are none."""


def begun(header: bytes, body: int) -> bytes:
    """Return the beginning of a frame, up to its body.

    Args:
        header: JSON.
        body: bytes of the buffers with the gaps between them.

    Raises:
        PackingError: header or body is over its limit.
    """
    header += b" " * (-len(header) % _ALIGN)
    if len(header) > HEADER_LIMIT or body > BODY_LIMIT:
        raise PackingError(
            f"lists and text of {len(header)} bytes, or buffers of {body}, are over the limits of {HEADER_LIMIT} and "
            f"{BODY_LIMIT}: use arrays"
        )
    return _PREFIX.pack(_MAGIC, len(header), body) + header


def gap(size: int) -> bytes:
    """Return the padding after a buffer of this size, so that the next one begins at a multiple of 16."""
    return _ZEROS[: -size % _ALIGN]


def lengths(prefix: Data) -> tuple[int, int]:
    """Return the lengths of the header and the body that follow the first `PREFIX_BYTES` bytes of a frame.

    Raises:
        PackingError: the bytes are no prefix, or a length is over its limit.
    """
    try:
        magic, header, body = _PREFIX.unpack_from(prefix)
    except struct.error:
        raise PackingError(f"a frame begins with {PREFIX_BYTES} bytes, got {len(prefix)}") from None
    if magic != _MAGIC:
        raise PackingError(f"a frame begins with {_MAGIC!r}, got {bytes(magic)!r}: the stream is out of step")
    if header > HEADER_LIMIT or body > BODY_LIMIT:
        raise PackingError(
            f"a frame of {header} and {body} bytes is over the limits of {HEADER_LIMIT} and {BODY_LIMIT}: the "
            "stream is out of step"
        )
    return header, body
