"""What a server does while its model thinks for half a second: let newcomers in, and give signs of life."""

from __future__ import annotations

import statistics
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from benchmarks.serving_bench import payloads, processes
from benchmarks.serving_bench.contenders import XPL, Contender
from benchmarks.serving_bench.latency import percentile
from benchmarks.serving_bench.model import Model
from xpl import _spec as spec
from xpl.wire import codec

MODEL = Model(fixed_ms=500)
PAUSE_S = 0.02
"""Between two signs of life, so that they meet the inference at many moments."""
ANSWER_S = 30.0


def run(running: Sequence[tuple[Contender, str]], inferences: int) -> list[dict[str, Any]]:
    """Measure every contender that serves WebSocket, once per family.

    Returns:
        One row per contender: p50 and p99 in ms of a new connection's WebSocket handshake and of a sign of life, which
        is the wire's heartbeat on the connection that waits for the inference where the wire is ours, and a WebSocket
        ping on another connection elsewhere; or `failed` and why.
    """
    rows: list[dict[str, Any]] = []
    for contender, python in running:
        if not contender.websocket or "/" in contender.name:
            continue
        print(f"responsiveness: {contender.name}", file=sys.stderr)
        try:
            with processes.server(python, contender.module, contender.setting, MODEL) as server:
                address = server.first["address"]
                if contender.family == XPL:
                    beats, handshakes = _on_our_wire(address, inferences)
                else:
                    with processes.client(python, contender.module, contender.setting, address) as client:
                        beats, handshakes = _on_another(client, address, inferences)
        except (processes.EndError, OSError, WebSocketException) as error:
            rows.append({"contender": contender.name, "failed": f"{type(error).__name__}: {error}"})
        else:
            rows.append({"contender": contender.name, "heartbeat": _summary(beats), "handshake": _summary(handshakes)})
    return rows


def _on_our_wire(address: str, inferences: int) -> tuple[list[float], list[float]]:
    observation = payloads.make("state").observations[0]
    beats: list[float] = []
    with _socket(address) as socket:
        _ask(socket, spec.Message.HELLO, {})
        _ask(socket, spec.Message.RESET, {spec.Payload.TRIAL_ID: None})

        def infer() -> None:
            """Send one inference request, and heartbeats until its answer comes; answers may overtake each other."""
            frame = _send(socket, spec.Message.INFER, {spec.Payload.OBSERVATION: observation})
            while True:
                started = time.perf_counter()
                beat = _send(socket, spec.Message.HEARTBEAT, {})
                awaited = {frame.message_id, beat.message_id}
                while beat.message_id in awaited:
                    answer = _receive(socket)
                    awaited.discard(answer.message_id)
                beats.append((time.perf_counter() - started) * 1000)
                if frame.message_id not in awaited:
                    return
                time.sleep(PAUSE_S)

        def work() -> None:
            for _ in range(inferences):
                infer()

        handshakes = _meanwhile(address, work)
    return beats, handshakes


def _on_another(client: processes.End, address: str, inferences: int) -> tuple[list[float], list[float]]:
    beats: list[float] = []
    order = {"payload": "state", "requests": inferences, "limit_s": ANSWER_S, "warm_up": 0}

    def infer() -> None:
        with _socket(address) as socket:
            client.send(**order)
            until = time.perf_counter() + inferences * MODEL.fixed_ms / 1000
            while (started := time.perf_counter()) < until:
                socket.ping().wait(ANSWER_S)
                beats.append((time.perf_counter() - started) * 1000)
                time.sleep(PAUSE_S)
            client.answer(ANSWER_S + inferences)

    return beats, _meanwhile(address, infer)


def _meanwhile(address: str, work: Callable[[], object]) -> list[float]:
    """Open connections, one after the other, while some work goes on; return the times of their handshakes, ms."""
    done = threading.Event()

    def knock() -> list[float]:
        times = []
        while not done.wait(PAUSE_S):
            started = time.perf_counter()
            with _socket(address):
                times.append((time.perf_counter() - started) * 1000)
        return times

    with ThreadPoolExecutor(1) as pool:
        knocking = pool.submit(knock)
        try:
            work()
        finally:
            done.set()
        return knocking.result()


def _socket(address: str) -> ClientConnection:
    return connect(address, compression=None, max_size=None, proxy=None, open_timeout=ANSWER_S)


def _send(socket: ClientConnection, message_type: str, payload: dict[str, Any]) -> codec.Frame:
    frame = codec.Frame(message_type, "benchmark", payload)
    socket.send(codec.encode(frame))
    return frame


def _receive(socket: ClientConnection) -> codec.Frame:
    data = socket.recv(timeout=ANSWER_S)
    assert isinstance(data, bytes)
    answer = codec.decode(data)
    if answer.message_type == spec.Message.ERROR:
        raise processes.EndError(str(answer.payload))
    return answer


def _ask(socket: ClientConnection, message_type: str, payload: dict[str, Any]) -> None:
    frame = _send(socket, message_type, payload)
    while _receive(socket).message_id != frame.message_id:
        pass


def _summary(times: Sequence[float]) -> dict[str, float]:
    return {"count": len(times), "p50_ms": statistics.median(times), "p99_ms": percentile(times, 99)}
