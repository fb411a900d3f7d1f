"""The private stream between the server's front end and a worker: a little JSON and raw buffers, one after the other.

    <"XPLL"><header length: u32><body length: u64>   little endian
    <header: JSON [head, [length of each buffer]], UTF-8, padded with spaces>
    <body: the buffers, each at a multiple of 16 bytes>

The buffers are packed values (`xpl.wire.packed`), which the front end passes on without reading them.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import socket

    from xpl.wire.arrays import Data

_PREFIX = struct.Struct("<4sIQ")
PREFIX_BYTES = _PREFIX.size
_MAGIC = b"XPLL"
_ALIGN = 16
_ZEROS = bytes(_ALIGN)
_SCRATCH = 1 << 16
_STEP = 1 << 26
HEADER_LIMIT = 1 << 26
BODY_LIMIT = 1 << 33
"""Bytes; more than any frame unpacks to. Only a stream that is out of step asks for more."""


class LinkError(ValueError):
    """A message cannot be sent, or what arrived is none."""


def _refuse(value: Any) -> Any:
    raise TypeError(
        f"a {type(value).__module__}.{type(value).__qualname__} cannot be sent: use text, numbers, lists, maps"
    )


_to_json = json.JSONEncoder(separators=(",", ":"), default=_refuse).encode


def encode(head: Any, buffers: Sequence[Data] = ()) -> list[Data]:
    """Return the pieces of one message; the buffers are not copied.

    Raises:
        LinkError: if the head is not made of what JSON knows, or is too large.
    """
    sizes = [len(buffer) for buffer in buffers]
    try:
        text = _to_json([head, sizes]).encode()
    except RecursionError:
        raise LinkError("the value contains itself, or is nested too deeply to be sent") from None
    except (TypeError, ValueError) as error:
        raise LinkError(str(error)) from None
    text += b" " * (-len(text) % _ALIGN)
    body = sum(size + -size % _ALIGN for size in sizes)
    if len(text) > HEADER_LIMIT or body > BODY_LIMIT:
        raise LinkError(f"a message of {len(text)} and {body} bytes is over the limits of {HEADER_LIMIT}, {BODY_LIMIT}")
    pieces: list[Data] = [_PREFIX.pack(_MAGIC, len(text), body) + text]
    for buffer, size in zip(buffers, sizes):
        pieces.append(buffer)
        if size % _ALIGN:
            pieces.append(_ZEROS[size % _ALIGN :])
    return pieces


def joined(pieces: Sequence[Data]) -> Sequence[Data]:
    """Return the pieces of a message as one where it is small: each that is sent wakes the other side."""
    return [b"".join(pieces)] if sum(map(len, pieces)) <= _SCRATCH else pieces


def decode(message: Data) -> tuple[Any, list[memoryview]]:
    """Return the head and the buffers of one message; the buffers are read-only views of it.

    Raises:
        LinkError: if it is not exactly one message.
    """
    view = memoryview(message).toreadonly()
    end = PREFIX_BYTES + _lengths(view)[0]
    try:
        head, sizes = json.loads(str(view[PREFIX_BYTES:end], "utf-8"))
        buffers = []
        for size in sizes:
            buffers.append(view[end : end + size])
            end += size + -size % _ALIGN
    except (ValueError, TypeError, RecursionError):
        raise LinkError("the header of a message is none: the stream is out of step") from None
    if end != len(view) or any(size < 0 for size in sizes):
        raise LinkError(f"a message of {end} bytes was announced, got {len(view)}: the stream is out of step")
    return head, buffers


def _lengths(prefix: Data) -> tuple[int, int]:
    """Return the lengths of header and body that a message's first bytes announce."""
    if len(prefix) < PREFIX_BYTES:
        raise LinkError(f"a message begins with {PREFIX_BYTES} bytes, got {len(prefix)}")
    magic, header, body = _PREFIX.unpack_from(prefix)
    if magic != _MAGIC or header > HEADER_LIMIT or body > BODY_LIMIT:
        raise LinkError(f"{bytes(prefix[:PREFIX_BYTES])!r} begins no message: the stream is out of step")
    return header, body


class Inbox:
    """Cuts a stream into messages, without I/O: read into `space()`, then say how much came.

    Args:
        largest: most bytes of a message's body; one that announces more is none.
    """

    def __init__(self, largest: int = BODY_LIMIT) -> None:
        self._largest = largest
        self._scratch = bytearray(_SCRATCH)
        self._kept = 0
        self._message: bytearray | None = None
        self._filled = 0
        self._total = 0

    def space(self) -> memoryview:
        """Return where the next bytes are to be put."""
        if self._message is None:
            return memoryview(self._scratch)[self._kept :]
        if self._filled == len(self._message):
            # In steps: what is announced is no reason to take that much memory.
            grown = bytearray(min(self._total, 2 * len(self._message)))
            grown[: self._filled] = self._message
            self._message = grown
        return memoryview(self._message)[self._filled :]

    def take(self, count: int) -> list[Data]:
        """Return the messages that `count` more bytes complete.

        Raises:
            LinkError: if the stream is out of step.
        """
        if self._message is None:
            return self._cut(memoryview(self._scratch)[: self._kept + count])
        self._filled += count
        if self._filled < self._total:
            return []
        whole, self._message = self._message, None
        return [whole]

    def _cut(self, view: memoryview) -> list[Data]:
        messages: list[Data] = []
        self._kept = 0
        while len(view) >= PREFIX_BYTES:
            header, body = _lengths(view)
            if body > self._largest:
                raise LinkError(f"a message of {body} bytes was announced, more than the {self._largest} it may have")
            total = PREFIX_BYTES + header + body
            if total > len(view):
                if total > _SCRATCH:
                    self._message, self._filled, self._total = bytearray(min(total, _STEP)), len(view), total
                    self._message[: len(view)] = view
                    return messages
                break
            messages.append(bytes(view[:total]))
            view = view[total:]
        rest = bytes(view)
        self._scratch[: len(rest)] = rest
        self._kept = len(rest)
        return messages


class Channel:
    """A blocking end of the stream: the worker's."""

    def __init__(self, channel: socket.socket) -> None:
        self._socket = channel
        self._inbox = Inbox()
        self._ready: list[Data] = []

    def send(self, head: Any, buffers: Sequence[Data] = ()) -> None:
        """Send a message.

        Raises:
            LinkError: if it cannot be sent; nothing was sent then.
            OSError: if the other end is gone.
        """
        for piece in joined(encode(head, buffers)):
            self._socket.sendall(piece)

    def receive(self) -> Data | None:
        """Return the bytes of the next message, or None at the end of the stream.

        Raises:
            LinkError: if what arrives is not a message.
        """
        while not self._ready:
            try:
                count = self._socket.recv_into(self._inbox.space())
            except OSError:
                return None
            if not count:
                return None
            self._ready = self._inbox.take(count)
        return self._ready.pop(0)
