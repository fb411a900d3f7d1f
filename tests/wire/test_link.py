from __future__ import annotations

import itertools
import os
import socket
import struct
import threading
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.wire.messages import framed, looped, peak
from xpl.process import link
from xpl.process.link import Channel, Inbox
from xpl.wire import process_frame
from xpl.wire.process_frame import PackingError


def message(header: int, body: int) -> bytes:
    content = (np.arange(header + body) % 251).astype(np.uint8).tobytes()
    return struct.pack("<4sIQ", b"XPL1", header, body) + content


def sent(head: Any, *buffers: bytes) -> tuple[Any, list[bytes]]:
    got, views = link.decode(b"".join(link.encode(head, buffers)))
    return got, list(map(bytes, views))


# -- messages ----------------------------------------------------------------------------------------------------------

HEADS = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=10,
)


@given(HEADS, st.lists(st.binary(max_size=40), max_size=5))
def test_a_message_arrives_as_it_was_sent(head: Any, buffers: list[bytes]) -> None:
    assert sent(head, *buffers) == (head, buffers)


@given(st.lists(st.binary(max_size=40), max_size=5))
def test_buffers_are_views_at_multiples_of_16_bytes(buffers: list[bytes]) -> None:
    whole = b"".join(link.encode("head", buffers))
    start = np.frombuffer(whole, np.uint8).ctypes.data
    for view in link.decode(whole)[1]:
        assert view.readonly
        array = np.frombuffer(view, np.uint8)
        assert not array.size or (array.ctypes.data - start) % 16 == 0
        assert not array.size or np.shares_memory(array, np.frombuffer(whole, np.uint8))


def test_buffers_are_not_copied() -> None:
    buffers = [bytes(1 << 20), bytearray(100), memoryview(bytes(10))]
    assert [piece for piece in link.encode({}, buffers) if any(piece is buffer for buffer in buffers)] == buffers


@pytest.mark.parametrize(
    "head",
    [object(), {1, 2}, b"bytes", np.zeros(3), np.float32(1), 10**5000, looped()],
    ids=lambda head: type(head).__name__,
)
def test_a_head_that_json_does_not_know_cannot_be_sent(head: Any) -> None:
    with pytest.raises(PackingError):
        link.encode([{"head": head}])


def test_a_head_over_the_limit_cannot_be_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_frame, "HEADER_LIMIT", 100)
    with pytest.raises(PackingError, match="over the limits"):
        link.encode("x" * 200)


@pytest.mark.parametrize(
    "data",
    [
        b"", b"XPL1", *map(framed, (b"", b"{}", b"[]", b"[1]", b"[1,2]", b"[1,[16]]", b"\xff\xfe", b"[" * 20_000)),
        framed(b"[1,[]]", bytes(16)), framed(b"[1,[8]]", bytes(32)), framed(b"[1,[-16,32]]", bytes(16)),
        framed(b"[1,[1.5]]", bytes(16)), framed(b'[1,["16"]]', bytes(16)), framed(b"[1,[null]]", bytes(16)),
        framed(b"[1,[%d]]" % 2**80, bytes(16)), framed(b"[1,[16]]", bytes(16))[:-1],
        framed(b"[1,[16]]", bytes(16)) + b"0",
    ],
    ids=lambda data: f"{len(data)} {data[16:32]!r}",
)  # fmt: skip
def test_what_is_no_message_is_refused(data: bytes) -> None:
    with pytest.raises(PackingError):
        link.decode(data)


# -- a stream of messages ----------------------------------------------------------------------------------------------


def fed(inbox: Inbox, stream: bytes, sizes: Sequence[int]) -> Iterator[bytes]:
    rest = memoryview(stream)
    for size in itertools.cycle(sizes):
        if not rest:
            return
        space = inbox.space()
        assert space, "there is always room for more"
        count = min(size, len(space), len(rest))
        space[:count] = rest[:count]
        rest = rest[count:]
        yield from map(bytes, inbox.take(count))


# Around what the inbox holds at once, and well beyond.
BODIES = st.integers(0, 100) | st.integers(65_480, 65_560) | st.sampled_from([65_536, 200_000])
READS = st.lists(st.integers(1, 40) | st.integers(60_000, 300_000), min_size=1, max_size=6)


@given(st.lists(st.builds(message, st.integers(0, 64), BODIES), max_size=8), READS)
def test_any_split_of_a_stream_gives_the_same_messages(messages: list[bytes], reads: list[int]) -> None:
    # Bytes one by one are the slowest way to find nothing new in long bodies.
    reads = [*reads, 5000]
    assert list(fed(Inbox(), b"".join(messages), reads)) == messages


@pytest.mark.parametrize("body", [0, 1, 65_519, 65_520, 65_521, 70_000])
def test_a_stream_of_single_bytes_is_cut_as_well(body: int) -> None:
    messages = [message(0, 0), message(16, body), message(3, 5)]
    stream = b"".join(messages)
    reads = [1] * 40 + [max(1, len(stream) - 100)] + [1] * 200
    assert list(fed(Inbox(), stream, reads)) == messages


def test_messages_stay_as_they_are_while_more_is_read() -> None:
    inbox = Inbox()
    first, second = message(16, 50), message(32, 100)
    kept = []
    for one in (first, second):
        inbox.space()[: len(one)] = one
        kept += inbox.take(len(one))
    assert list(map(bytes, kept)) == [first, second]


@pytest.mark.parametrize(
    "noise",
    [
        b"\xff" * 16,
        b"XPL2" + bytes(12),
        struct.pack("<4sIQ", b"XPL1", process_frame.HEADER_LIMIT + 1, 0),
        struct.pack("<4sIQ", b"XPL1", 2**32 - 1, 2**64 - 1),
        message(16, 4) + b"Traceback (most recent call last)",
    ],
)
def test_a_stream_out_of_step_is_a_link_error(noise: bytes) -> None:
    inbox = Inbox()

    def read() -> None:
        with pytest.raises(PackingError, match="out of step"):
            list(fed(inbox, noise, [7]))

    assert peak(read) < 100_000


def test_a_long_message_takes_memory_as_it_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link, "_STEP", 1 << 17)
    inbox, announced = Inbox(), struct.pack("<4sIQ", b"XPL1", 16, process_frame.BODY_LIMIT)
    assert peak(lambda: list(fed(inbox, announced + bytes(200_000), [70_000]))) < 2_000_000
    whole = message(16, 3_000_000)
    assert list(fed(Inbox(), whole, [100_000])) == [whole]


# -- over a real socket ------------------------------------------------------------------------------------------------


@pytest.fixture
def ends() -> Iterator[tuple[Channel, socket.socket]]:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        yield Channel(theirs), ours


@pytest.mark.parametrize("size", [0, 10, 100_000, 20_000_000])
def test_what_one_channel_sends_the_other_receives(size: int) -> None:
    buffers = [bytes([7]) * size, b"", b"x" * 3]
    left, right = socket.socketpair()
    with left, right:
        sender = threading.Thread(target=Channel(left).send, args=({"a": 1}, buffers))
        sender.start()
        arrived = Channel(right).receive()
        sender.join()
    assert arrived is not None
    head, views = link.decode(arrived)
    assert head == {"a": 1}
    assert list(map(bytes, views)) == buffers


def test_messages_that_arrive_together_are_received_one_by_one(ends: tuple[Channel, socket.socket]) -> None:
    channel, other = ends
    other.sendall(b"".join(b"".join(link.encode(number)) for number in range(5)))
    other.close()
    for number in range(5):
        received = channel.receive()
        assert received is not None
        assert link.decode(received) == (number, [])
    assert channel.receive() is None
    assert channel.receive() is None


def test_a_stream_that_ends_inside_a_message_ends(ends: tuple[Channel, socket.socket]) -> None:
    channel, other = ends
    other.sendall(b"".join(link.encode("head", [bytes(100_000)]))[:90_000])
    other.close()
    assert channel.receive() is None


def test_a_link_that_was_reset_ends(ends: tuple[Channel, socket.socket]) -> None:
    channel, other = ends
    channel.send("never read")  # closing with something unread resets the connection
    other.close()
    assert channel.receive() is None


def test_what_cannot_be_sent_leaves_the_link_as_it_was(ends: tuple[Channel, socket.socket]) -> None:
    channel, other = ends
    with pytest.raises(PackingError):
        channel.send({"object": object()}, [bytes(100_000)])
    channel.send("next")
    assert link.decode(other.recv(1000)) == ("next", [])


def test_sending_to_nobody_is_an_os_error(ends: tuple[Channel, socket.socket]) -> None:
    channel, other = ends
    other.close()
    with pytest.raises(OSError, match=os.strerror(32)):
        channel.send(1)
