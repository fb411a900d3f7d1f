"""Frames of a recording in little room: what is large in them is kept once, and all of it compressed.

A packed frame is a sequence of parts, each with its kind (1 byte), its length (4 bytes, little endian) and its content;
put together they are the bytes of the frame.

    0   literal     bytes, compressed by zlib
    1   piece       the same, of an array or of bytes of 4 KiB or more; pieces are numbered from 0 in their order
    2   repeated    the number (4 bytes, little endian) of a piece that came before
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from typing import IO, TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

LITERAL, PIECE, REPEATED = 0, 1, 2
_PART: Final = struct.Struct("<BI")
_NUMBER: Final = struct.Struct("<I")
_LARGE: Final = 4096
_LEVEL: Final = 1
"""Of zlib: an audit waits for it, and pictures gain little by more."""


class PackingError(ValueError):
    """Bytes that are no packed frame."""


class Packer:
    """Packs the frames of one recording, in their order."""

    def __init__(self) -> None:
        self._pieces: dict[bytes, int] = {}

    def pack(self, data: bytes, payload: Any) -> bytes:
        """Return the parts of a frame.

        Args:
            data: its bytes.
            payload: what they encode, in which large arrays are looked for.
        """
        parts, place = [], 0
        for piece in _large(payload):
            begin = data.find(piece, place)
            if begin < 0:  # encoded otherwise than it lies in memory
                continue
            parts += [_part(LITERAL, zlib.compress(data[place:begin], _LEVEL)), self._kept(piece)]
            place = begin + len(piece)
        return b"".join([*parts, _part(LITERAL, zlib.compress(data[place:], _LEVEL))])

    def _kept(self, piece: bytes) -> bytes:
        name = hashlib.sha256(piece).digest()
        if name in self._pieces:
            return _part(REPEATED, _NUMBER.pack(self._pieces[name]))
        self._pieces[name] = len(self._pieces)
        return _part(PIECE, zlib.compress(piece, _LEVEL))


class Unpacker:
    """Puts the frames of one recording together again, in their order.

    Args:
        stream: the file that holds them; its position is changed.
        most: bytes that a frame may have.
    """

    def __init__(self, stream: IO[bytes], most: int) -> None:
        self._stream = stream
        self._most = most
        self._pieces: list[tuple[int, int]] = []

    def unpack(self, packed: bytes, begin: int) -> bytes:
        """Return the bytes of a frame.

        Args:
            packed: its parts.
            begin: where they begin in the file.

        Raises:
            PackingError: they make no frame, or one that is too large.
        """
        found, room = [], self._most
        for kind, place, length in _parts(packed):
            content = packed[place : place + length]
            if kind == PIECE:
                self._pieces.append((begin + place, length))
            elif kind == REPEATED:
                content = self._again(content)
            elif kind != LITERAL:
                raise PackingError(f"there is no part of kind {kind}")
            found.append(_inflated(content, room))
            room -= len(found[-1])
        return b"".join(found)

    def _again(self, content: bytes) -> bytes:
        number = _NUMBER.unpack(content)[0] if len(content) == _NUMBER.size else len(self._pieces)
        if number >= len(self._pieces):
            raise PackingError("it repeats what did not come before")
        place, length = self._pieces[number]
        self._stream.seek(place)
        return self._stream.read(length)


def _part(kind: int, content: bytes) -> bytes:
    return _PART.pack(kind, len(content)) + content


def _parts(packed: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield kind, place and length of each part."""
    place = 0
    while place < len(packed):
        if place + _PART.size > len(packed):
            raise PackingError("a part of it is cut")
        kind, length = _PART.unpack_from(packed, place)
        place += _PART.size
        if place + length > len(packed):
            raise PackingError("a part of it is longer than the frame")
        yield kind, place, length
        place += length


def _inflated(content: bytes, most: int) -> bytes:
    reader = zlib.decompressobj()
    try:
        data = reader.decompress(content, most + 1)
    except zlib.error as error:
        raise PackingError(f"a part of it cannot be decompressed: {error}") from None
    if len(data) > most or not reader.eof:
        raise PackingError(f"it is cut, or larger than the {most} bytes that a frame may have")
    return data


def _large(value: Any) -> Iterator[bytes]:
    """Yield the bytes of large arrays and large bytes in a payload, in the order in which it is encoded."""
    if isinstance(value, dict):
        for inner in value.values():
            yield from _large(inner)
    elif isinstance(value, (list, tuple)):
        for inner in value:
            yield from _large(inner)
    elif isinstance(value, bytes):
        if len(value) >= _LARGE:
            yield value
    elif getattr(value, "nbytes", 0) >= _LARGE and not getattr(value.dtype, "hasobject", True):
        yield value.tobytes()
