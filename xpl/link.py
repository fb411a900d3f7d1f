"""The private stream between the server's front end and a worker: packed values (`xpl.packed`), one after the other."""

from __future__ import annotations

import socket
from typing import Any

from xpl import packed
from xpl.arrays import Data

_SCRATCH = 1 << 16


class Inbox:
    """Cuts a stream into messages, without I/O: read into `space()`, then say how much came."""

    def __init__(self) -> None:
        self._scratch = bytearray(_SCRATCH)
        self._kept = 0
        self._message: bytearray | None = None
        self._filled = 0

    def space(self) -> memoryview:
        """Return where the next bytes are to be put."""
        if self._message is not None:
            return memoryview(self._message)[self._filled :]
        return memoryview(self._scratch)[self._kept :]

    def take(self, count: int) -> list[Data]:
        """Return the messages that `count` more bytes complete.

        Raises:
            PackingError: if the stream is out of step.
        """
        if self._message is not None:
            self._filled += count
            if self._filled < len(self._message):
                return []
            whole, self._message = self._message, None
            return [whole]
        return self._cut(memoryview(self._scratch)[: self._kept + count])

    def _cut(self, view: memoryview) -> list[Data]:
        messages: list[Data] = []
        self._kept = 0
        while len(view) >= packed.PREFIX_BYTES:
            total = packed.PREFIX_BYTES + sum(packed.lengths(view))
            if total > len(view):
                if total > _SCRATCH:
                    self._message, self._filled = bytearray(total), len(view)
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

    def send(self, value: Any) -> None:
        """Send a value.

        Raises:
            PackingError: if it cannot be packed; nothing was sent then.
            OSError: if the other end is gone.
        """
        pieces = packed.encode(value)
        if sum(map(len, pieces)) <= _SCRATCH:
            pieces = [b"".join(pieces)]
        for piece in pieces:
            self._socket.sendall(piece)

    def receive(self) -> Data | None:
        """Return the bytes of the next message, or None at the end of the stream.

        Raises:
            PackingError: if what arrives is not a message.
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
