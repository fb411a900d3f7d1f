"""Memory of messages in sum: many connections that each take a little, or a lot."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.outside.raw import BINARY, Raw
from tests.support.peer import DEADLINE_S, Peer, greeted, wait_until
from xpl import Client
from xpl import _spec as spec
from xpl.wire import codec
from xpl_cli.serving.entry.memory_limiter import MessageMemoryLimiter

if TYPE_CHECKING:
    from collections.abc import Callable

    from xpl_cli.serving.launch import RunningServer

MODEL = """
    class Model:
        def __init__(self, config): pass
        def update_obs(self, obs): pass
        def get_action(self): return [1]
        def reset(self): pass
"""
ONCE: dict[str, Any] = {"max_connect_attempts": 1, "connect_timeout_s": DEADLINE_S}
MIB = 1 << 20


def resident(server: RunningServer) -> int:
    """Return the memory of the server's own process, bytes."""
    status = Path(f"/proc/{server.pid}/status").read_text("ascii")
    return int(status.partition("RssAnon:")[2].split()[0]) << 10


def test_unfinished_messages_are_bounded_in_sum(
    write_adapter: Callable[..., Path], serve: Callable[..., RunningServer]
) -> None:
    """Connections without a slot hold what one message may; who is honest comes in and is served."""
    server = serve(write_adapter(MODEL))
    size = spec.LIMITS["early_bytes"] // 4
    with contextlib.ExitStack() as stack:
        taken = []
        for _ in range(8):
            raw = stack.enter_context(contextlib.closing(Raw(server.url)))
            with contextlib.suppress(OSError):  # it is closed meanwhile
                raw.send(BINARY, bytes(size), size=size + MIB)
            taken.append(raw)
        with Client(server.url, config=ONCE) as client:
            assert client.infer({}) == [1]
        wait_until(lambda: any("too much memory" in line for line in server.log), "some are closed")
        assert resident(server) < 1.5 * spec.LIMITS["early_bytes"]


def test_a_connection_is_counted_by_the_room_that_it_keeps(
    write_adapter: Callable[..., Path], serve: Callable[..., RunningServer]
) -> None:
    """A whole message that was answered or refused leaves its buffer behind."""
    server = serve(write_adapter(MODEL))
    heartbeat = codec.encode(codec.Frame("heartbeat", "e", {"x": bytes(spec.LIMITS["early_bytes"] // 4)}))
    with contextlib.ExitStack() as stack:
        for _ in range(7):
            raw = stack.enter_context(contextlib.closing(Raw(server.url)))
            with contextlib.suppress(OSError, EOFError):
                raw.send(BINARY, heartbeat)
                raw.receive()
        assert resident(server) < 1.5 * spec.LIMITS["early_bytes"]
        with Client(server.url, config=ONCE) as client:
            assert client.infer({}) == [1]


class Holder:
    def __init__(self, slot: object) -> None:
        self.slot = slot
        self.buffered_bytes = 0
        self.is_closed = False

    def close(self, code: int, reason: str = "") -> None:
        assert (code, reason) == (1013, "the messages of all connections take too much memory")

    def abort(self) -> None:
        self.is_closed = True


@settings(max_examples=examples(100), deadline=None)
@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 60), st.booleans()), max_size=40))
def test_the_sum_is_kept_and_nobody_goes_who_takes_little(notes: list[tuple[int, int, bool]]) -> None:
    """Those with a slot hold 100 together, those without 40; a part below the average one is safe."""
    crowd, there = MessageMemoryLimiter(100, 40), [Holder(None) for _ in range(6)]
    for number, size, has_place in notes:
        holder = there[number]
        if holder.is_closed:
            crowd.forget(holder)
            holder = there[number] = Holder(None)
        holder.buffered_bytes, holder.slot = size, holder.slot or (1 if has_place else None)
        crowd.update(holder)
        alive = [one for one in there if not one.is_closed]
        assert sum(one.buffered_bytes for one in alive) <= 100
        assert sum(one.buffered_bytes for one in alive if one.slot is None) <= 40
    assert all(one.buffered_bytes > 40 // 6 for one in there if one.is_closed)


@pytest.mark.parametrize("name", ["message_id", "evaluation_id", "trial_id", "message_type"])
def test_an_identifier_is_short(
    write_adapter: Callable[..., Path], serve: Callable[..., RunningServer], name: str
) -> None:
    """It is kept with places and answers, and comes back with each of them."""
    server = serve(write_adapter(MODEL))
    fields = {**vars(codec.Frame("heartbeat", "e")), name: "x" * (spec.LIMITS["identifier"] + 1)}
    with greeted(server.url) as peer:
        peer.socket.send(msgpack.packb(fields))
        if name != "message_id":  # otherwise it cannot be answered
            answer = peer.receive()
            assert answer.payload["code"] == "invalid_frame"
            assert f"{name} must be str" in answer.payload["message"]
        assert peer.ask("heartbeat").message_type == "heartbeat_ack"
    with pytest.raises(codec.WireError, match="at most 1024 characters, got 1025 characters"):
        codec.encode(codec.Frame("heartbeat", "x" * 1025))


def test_a_session_is_short(write_adapter: Callable[..., Path], serve: Callable[..., RunningServer]) -> None:
    server = serve(write_adapter(MODEL))
    peer = Peer(server.url)
    answer = peer.ask("hello", {"capabilities": {"session": "x" * (spec.LIMITS["identifier"] + 1)}})
    assert answer.payload["code"] == "invalid_frame"
    assert "may hold texts of 1024 characters" in answer.payload["message"]
    peer.close()
