from __future__ import annotations

import itertools
import os
import socket
import struct
import threading
import tracemalloc
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xpl import packed
from xpl.link import Channel, Inbox
from xpl.packed import PackingError


def message(header: int, body: int) -> bytes:
    """Return a message of these lengths, with content that tells where it was."""
    content = (np.arange(header + body) % 251).astype(np.uint8).tobytes()
    return struct.pack("<4sIQ", b"XPL1", header, body) + content


def fed(inbox: Inbox, stream: bytes, sizes: Sequence[int]) -> Iterator[bytes]:
    """Yield the messages that come out while a stream goes in, in reads of at most these sizes, again and again."""
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
    """From messages of nothing to those far larger than one read."""
    # Bytes one by one are the slowest way to find nothing new in long bodies.
    reads = [*reads, 5000]
    assert list(fed(Inbox(), b"".join(messages), reads)) == messages


@pytest.mark.parametrize("body", [0, 1, 65_519, 65_520, 65_521, 70_000])
def test_a_stream_of_single_bytes_is_cut_as_well(body: int) -> None:
    """Also where the prefix itself comes in pieces."""
    messages = [message(0, 0), message(16, body), message(3, 5)]
    stream = b"".join(messages)
    reads = [1] * 40 + [max(1, len(stream) - 100)] + [1] * 200
    assert list(fed(Inbox(), stream, reads)) == messages


def test_messages_stay_as_they_are_while_more_is_read() -> None:
    """An answer may be looked at long after the next one has come."""
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
        struct.pack("<4sIQ", b"XPL1", packed.HEADER_LIMIT + 1, 0),
        struct.pack("<4sIQ", b"XPL1", 2**32 - 1, 2**64 - 1),
        message(16, 4) + b"Traceback (most recent call last)",
    ],
)
def test_a_stream_out_of_step_is_a_packing_error(noise: bytes) -> None:
    """Before anything of the size that it seems to announce is set aside."""
    inbox = Inbox()
    tracemalloc.start()
    with pytest.raises(PackingError, match="out of step"):
        list(fed(inbox, noise, [7]))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 100_000


# -- over a real socket ------------------------------------------------------------------------------------------------


@pytest.fixture
def ends() -> Iterator[tuple[Channel, socket.socket]]:
    """Return a worker's end of a link and the raw other one."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        yield Channel(theirs), ours


@pytest.mark.parametrize("size", [0, 10, 100_000, 2_000_000])
def test_what_one_channel_sends_the_other_receives(size: int) -> None:
    """Also far more than the system keeps in between."""
    value: dict[str, Any] = {"array": np.arange(size) % 251, "text": "é", "small": [np.float32(1)] * 100}
    left, right = socket.socketpair()
    with left, right:
        sender = threading.Thread(target=Channel(left).send, args=(value,))
        sender.start()
        arrived = Channel(right).receive()
        sender.join()
    assert arrived is not None
    got = packed.decode(arrived)
    assert got["array"].tobytes() == value["array"].tobytes()
    assert (got["text"], got["small"]) == (value["text"], value["small"])


def test_messages_that_arrive_together_are_received_one_by_one(ends: tuple[Channel, socket.socket]) -> None:
    """In their order, and then the end of the stream."""
    channel, other = ends
    other.sendall(b"".join(b"".join(packed.encode(number)) for number in range(5)))
    other.close()
    for number in range(5):
        message = channel.receive()
        assert message is not None
        assert packed.decode(message) == number
    assert channel.receive() is None
    assert channel.receive() is None


def test_a_stream_that_ends_inside_a_message_ends(ends: tuple[Channel, socket.socket]) -> None:
    """Half a message is none."""
    channel, other = ends
    other.sendall(b"".join(packed.encode(np.zeros(100_000)))[:-1][:100_000])
    other.close()
    assert channel.receive() is None


def test_a_link_that_was_reset_ends(ends: tuple[Channel, socket.socket]) -> None:
    """As one that was closed in order."""
    channel, other = ends
    channel.send("never read")  # closing with something unread resets the connection
    other.close()
    assert channel.receive() is None


def test_noise_is_a_packing_error(ends: tuple[Channel, socket.socket]) -> None:
    """It is not waited for more."""
    channel, other = ends
    other.sendall(b"a print on the wrong descriptor\n")
    with pytest.raises(PackingError, match="out of step"):
        channel.receive()


def test_what_cannot_be_packed_leaves_the_link_as_it_was(ends: tuple[Channel, socket.socket]) -> None:
    """Nothing of it was sent."""
    channel, other = ends
    with pytest.raises(PackingError):
        channel.send({"large": np.zeros(100_000), "object": object()})
    channel.send("next")
    assert packed.decode(other.recv(1000)) == "next"


def test_sending_to_nobody_is_an_os_error(ends: tuple[Channel, socket.socket]) -> None:
    """For the caller to decide on."""
    channel, other = ends
    other.close()
    with pytest.raises(OSError, match=os.strerror(32)):
        channel.send(1)
