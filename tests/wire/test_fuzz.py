from __future__ import annotations

import contextlib
import importlib.util
import io
import itertools
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from tests.support.examples import examples
from tests.wire.fuzz import decoder
from tests.wire.messages import framed, peak
from xpl import _spec as spec
from xpl import image_codec
from xpl.observation import ObservationError
from xpl.wire import codec, packed
from xpl_cli.serving.requests import ReplayEntry, RequestError
from xpl_cli.serving.slots import SlotPool

FACTOR, SLACK = 400, 2_000_000
"""Memory that reading may take: so many times the bytes that were read, and so many more.

An empty map takes one byte on the wire and 64 in memory, a map with one entry 3 and 232, a row of a packed list as
little as one byte and 340; the reader of msgpack takes a mebibyte to begin with.
"""

bounded = settings(max_examples=examples(300), deadline=None)
PROCESSOR_S = 2.0
"""What one example may use of a processor; how long it takes depends on what else the machine does."""


def cost(action: Callable[[], object]) -> int:
    """Return the most memory, in bytes, that was in use at a time during an action, which may not take long."""
    began = time.process_time()
    most = peak(action)
    assert time.process_time() - began < PROCESSOR_S
    return most


# -- bytes of strangers ------------------------------------------------------------------------------------------------

SEEDS = list(decoder.seeds())
ENDS = st.integers(0, 1 << 12)
CHANGES = st.lists(
    st.one_of(
        st.tuples(st.just("set"), ENDS, st.binary(min_size=1, max_size=8)),
        st.tuples(st.just("insert"), ENDS, st.binary(min_size=1, max_size=8)),
        st.tuples(st.just("size"), ENDS, st.sampled_from([b"\xff" * 4, b"\x7f\xff\xff\xff", b"\0" * 4, b"9" * 4])),
        st.tuples(st.just("delete"), ENDS, ENDS),
        st.tuples(st.just("repeat"), ENDS, ENDS),
    ),
    min_size=1,
    max_size=6,
)


def changed(data: bytes, changes: list[tuple[str, int, Any]]) -> bytes:
    for kind, position, what in changes:
        start = position % (len(data) + 1)
        if kind == "insert":
            data = data[:start] + what + data[start:]
        elif isinstance(what, bytes):
            data = data[:start] + what + data[start + len(what) :]
        else:
            end = start + what % (len(data) + 1)
            data = data[:start] + (data[start:end] * 3 if kind == "repeat" else b"") + data[end:]
    return data


@bounded
@given(st.sampled_from(SEEDS), CHANGES)
def test_damaged_messages_are_read_or_refused(seed: tuple[int, bytes], changes: list[tuple[str, int, Any]]) -> None:
    target, data = seed[0], changed(seed[1], changes)
    assert cost(lambda: decoder.TARGETS[target](data)) < FACTOR * len(data) + SLACK


@bounded
@given(st.sampled_from(decoder.TARGETS), st.binary(max_size=300))
def test_noise_is_refused(target: Callable[[bytes], None], data: bytes) -> None:
    assert cost(lambda: target(data)) < FACTOR * len(data) + SLACK


@pytest.mark.parametrize(
    "message",
    [
        pytest.param(framed([{"@bytes": [0, 10_000]}] * 1000, bytes(10_000)), id="bytes told often"),
        pytest.param(framed([{"@array": [0, "|u1", [10_000]]}] * 1000, bytes(10_000)), id="array told often"),
        pytest.param(
            framed({"@rows": {str(column): [0, "|u1", [9999, 1]] for column in range(10)}}, bytes(10_000)),
            id="columns told often",
        ),
        pytest.param(framed({"@rows": {"a": [0, "|u1", [29_999, 1]]}}, bytes(29_999)), id="short rows"),
        pytest.param(framed({"@rows": {"a": [0, "|u1", [99_999, 0]]}}), id="empty rows"),
        pytest.param(framed({"@array": [0, "|u1", [0, 2**62]]}), id="empty array"),
        pytest.param(framed([[[]] * 99] * 99), id="empty lists"),
        pytest.param(framed(0)[:8] + b"\xff" * 8, id="long body announced"),
    ],
)
def test_a_packed_value_cannot_ask_for_much(message: bytes) -> None:
    """Whatever refers to the same bytes again and again, the memory stays in proportion to the message."""

    def read() -> None:
        with contextlib.suppress(packed.PackingError):
            packed.decode(message)

    assert cost(read) < FACTOR * len(message) + SLACK


# -- images ------------------------------------------------------------------------------------------------------------

PICTURE = (np.arange(24 * 32 * 3) % 251).astype(np.uint8).reshape(24, 32, 3)


def other_format(name: str) -> bytes:
    from PIL import Image

    target = io.BytesIO()
    Image.fromarray(PICTURE).save(target, name)
    return target.getvalue()


PICTURES = [
    image_codec.encode_jpeg(PICTURE),
    image_codec.encode_png(PICTURE),
    *map(other_format, ("JPEG", "BMP", "TIFF", "WEBP")),
]


@bounded
@given(st.sampled_from(PICTURES), CHANGES)
def test_damaged_images_are_decoded_or_refused(data: bytes, changes: list[tuple[str, int, Any]]) -> None:
    with contextlib.suppress(ObservationError):
        image = image_codec.decode(changed(data, changes))
        assert image.dtype == np.uint8
        assert image.shape[2:] == (3,)
        assert image.shape[0] * image.shape[1] <= image_codec.PIXELS


@bounded
@given(st.binary(max_size=300))
def test_the_marker_is_looked_for_in_anything(data: bytes) -> None:
    assert image_codec.has_marker(b"\xff\xd8" + data) in (True, False)


# -- who may use what, and what runs -----------------------------------------------------------------------------------

GRACE_S = 10.0
REMEMBERED = 6
CLIENTS = st.integers(0, 4)


class Sessions(RuleBasedStateMachine):
    """Clients that come, ask, repeat themselves, get lost, come back and leave, against places and their memories.

    A client is its evaluation_id; some have a secret as well. `runs` counts what the model would have done.
    """

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.numbers = itertools.count()
        self.connections: dict[int, int] = {}  # client -> its connection that stands
        self.tenancies: dict[int, int] = {}  # client -> tenancy that it must find again
        self.until: dict[int, float] = {}  # client -> until when its place must wait for it
        self.asked: dict[int, list[codec.Frame]] = {}  # tenancy -> requests in order
        self.running: list[tuple[codec.Frame, Any, ReplayEntry]] = []
        self.runs: Counter[tuple[int, str]] = Counter()

    @initialize(workers=st.integers(1, 2), shared=st.integers(1, 2))
    def start(self, workers: int, shared: int) -> None:
        self.places = SlotPool(workers, shared, GRACE_S, clock=lambda: self.now)

    @rule(client=CLIENTS)
    def come(self, client: int) -> None:
        """Say hello on a new connection; clients with even numbers have a secret, and may still seem connected."""
        secret = f"secret {client}" if client % 2 == 0 else None
        if client in self.connections and secret is None:
            return
        connection = next(self.numbers)
        others = {place for place in map(self.places.slot_of, self.connections.values()) if place}
        waits = self.until.get(client, -1.0) > self.now
        try:
            place, lost = self.places.assign(connection, f"evaluation {client}", secret)
        except RequestError:  # busy
            if client in self.connections or waits:
                raise AssertionError("a client was locked out of its own place") from None
            return
        assert lost == self.connections.get(client)
        assert place not in others or lost is not None, "a place was given away that another connection has"
        if lost is not None or waits:
            assert place.tenancy == self.tenancies[client], "a client that came back lost its place"
        for other, tenancy in self.tenancies.items():
            if other != client and self.until.get(other, -1.0) > self.now:
                assert place.tenancy != tenancy, "a place was given away that waits for its client"
        self.connections[client], self.tenancies[client] = connection, place.tenancy
        self.asked.setdefault(place.tenancy, [])

    @precondition(lambda self: self.connections)
    @rule(data=st.data(), clean=st.booleans())
    def leave(self, data: st.DataObject, clean: bool) -> None:
        client = data.draw(st.sampled_from(sorted(self.connections)))
        assert self.places.release(self.connections.pop(client), clean=clean)
        self.until[client] = self.now if clean else self.now + GRACE_S
        if clean:
            self.asked[self.tenancies[client]] = []

    @rule(seconds=st.sampled_from([1.0, GRACE_S]))
    def wait(self, seconds: float) -> None:
        self.now += seconds

    @precondition(lambda self: self.connections)
    @rule(data=st.data(), back=st.integers(0, REMEMBERED - 1), kind=st.sampled_from(["infer", "reset"]))
    def ask(self, data: st.DataObject, back: int, kind: str) -> None:
        client = data.draw(st.sampled_from(sorted(self.connections)))
        place = self.places.slot_of(self.connections[client])
        assert place is not None
        history = self.asked[place.tenancy]
        known = back < len(history)
        frame = history[-1 - back] if known else codec.Frame(kind, "e", message_id=str(next(self.numbers)))
        if not known:
            history.append(frame)
        if place.replay.find(frame) is None:
            self.runs[place.tenancy, frame.message_id] += 1
            self.running.append((frame, place, place.replay.begin(frame)))

    @precondition(lambda self: self.running)
    @rule(data=st.data(), size=st.integers(0, 40))
    def answer(self, data: st.DataObject, size: int) -> None:
        frame, place, entry = self.running.pop(data.draw(st.integers(0, len(self.running) - 1)))
        heard: list[bytes] = []
        entry.waiting.append(heard.append)
        place.replay.finish(frame.message_id, entry, bytes(size))
        assert heard == [bytes(size)]

    @invariant()
    def nothing_ran_twice(self) -> None:
        assert all(count == 1 for count in self.runs.values()), self.runs

    @invariant()
    def every_connection_has_a_place_of_its_own(self) -> None:
        held = [self.places.slot_of(connection) for connection in self.connections.values()]
        assert None not in held
        assert len(set(map(id, held))) == len(held)

    @invariant()
    def memory_is_bounded(self) -> None:
        for connection in self.connections.values():
            place = self.places.slot_of(connection)
            assert place is not None
            running = sum(entry.answer is None for entry in place.replay._entries.values())
            assert running or len(place.replay) <= REMEMBERED
            assert running or place.replay.size <= REMEMBERED * 40


@pytest.mark.usefixtures("small_memory")
def test_sessions_hold_whatever_clients_do() -> None:
    run_state_machine_as_test(
        Sessions, settings=settings(max_examples=examples(200), stateful_step_count=40, deadline=None)
    )


@pytest.fixture
def small_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(spec.LIMITS, "replay_entries", REMEMBERED)
    monkeypatch.setitem(spec.LIMITS, "replay_bytes", REMEMBERED * 40)


# -- guided by coverage ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_decoders_withstand_a_fuzzer_that_sees_their_branches(tmp_path: Path) -> None:
    if importlib.util.find_spec("atheris") is None:
        pytest.skip("not run: atheris is not installed")
    for number, (target, data) in enumerate(decoder.seeds()):
        (tmp_path / f"seed-{number}").write_bytes(bytes([target]) + data)
    limits = ["-max_total_time=10", "-timeout=5", "-rss_limit_mb=1024", "-max_len=4096", "-print_final_stats=1"]
    run = subprocess.run(
        [sys.executable, decoder.__file__, *limits, f"-artifact_prefix={tmp_path}/", tmp_path],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-5000:]
