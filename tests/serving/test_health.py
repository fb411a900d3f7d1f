from __future__ import annotations

import asyncio
import collections
import contextlib
import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families
from websockets.exceptions import ConnectionClosed

from tests.support.outside.raw import CLOSE, Raw, page
from tests.support.peer import DEADLINE_S, Peer, greeted, wait_until
from xpl import Client
from xpl.client import AsyncClient, PolicyServerError, ServerConnectionError
from xpl_cli.basics.errors import ExitCode
from xpl_cli.serving import fork_server
from xpl_cli.serving.launch import RunningServer, running_server

# Waits on named pipes: while it loads, and where an observation says so.
SUBJECT = """
    class Model:
        def __init__(self, config):
            self.n = None
            if config.get("loading"):
                print("weights 1 of 2")
                wait(config["loading"])

        def update_obs(self, obs):
            self.n = obs.get("n")
            if obs.get("fifo"):
                wait(obs["fifo"])
            if obs.get("fail"):
                raise ValueError("the gripper is unhappy")

        def get_action(self):
            return [self.n]

        def reset(self):
            self.n = None


    def wait(fifo):
        with open(fifo) as pipe:
            pipe.read()
"""
GOING_AWAY = 1001


@dataclass
class Started:
    """A server that may not be ready.

    Attributes:
        process: its front end.
        url: where it listens, or will.
        log: what it wrote on standard error.
    """

    process: subprocess.Popen[bytes] | fork_server.ForkedServer
    url: str
    log: collections.deque[str] = field(default_factory=collections.deque)

    def wait_ready(self) -> None:
        assert self.process.stdout is not None
        assert json.loads(self.process.stdout.readline())["event"] == "ready"

    def logs(self, text: str) -> str:
        """Wait for a line in the log and return it."""
        line: str = wait_until(
            lambda: next((line for line in list(self.log) if text in line), ""), f"{text!r} is logged"
        )
        return line


@pytest.fixture(scope="module")
def subject(write_adapter: Callable[..., Path]) -> Path:
    return write_adapter(SUBJECT)


@pytest.fixture
def start(subject: Path) -> Iterator[Callable[..., Started]]:
    """Return a function that starts a server and does not wait for it; `constants` are shortened intervals."""
    with contextlib.ExitStack() as stack:

        def begin(overrides: dict[str, Any], **constants: float) -> Started:
            with socket.create_server(("127.0.0.1", 0)) as probe:
                port = probe.getsockname()[1]
            arguments = ["serve", str(subject), "--port", str(port)]
            for name, value in overrides.items():
                arguments += ["--set", f"{name}={json.dumps(value)}"]
            process = anew(arguments, constants) if constants else fork_server.start(arguments)
            started = Started(process, f"ws://127.0.0.1:{port}")
            assert process.stderr is not None
            reader = threading.Thread(target=read_lines, args=(process.stderr, started.log))
            reader.start()
            stack.callback(lambda: sys.stdout.write("\n".join(started.log)))  # shown if the test fails
            stack.callback(end, process, reader)
            return started

        yield begin


def anew(arguments: list[str], constants: Mapping[str, float]) -> subprocess.Popen[bytes]:
    """Start the tool in an interpreter of its own, where its constants can be changed."""
    changed = "".join(f"{name.replace('__', '.')} = {value}; " for name, value in constants.items())
    head = "from xpl_cli import main; from xpl_cli.serving import run; from xpl_cli.serving.workers import worker"
    command = [sys.executable, "-c", f"{head}; {changed}main.run()", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def read_lines(stream: IO[bytes], log: collections.deque[str]) -> None:
    for line in stream:
        log.append(line.decode().rstrip("\n"))


def end(process: subprocess.Popen[bytes] | fork_server.ForkedServer, reader: threading.Thread) -> None:
    for _ in range(2):
        process.terminate()
    process.wait(DEADLINE_S)
    reader.join()
    for stream in (process.stdin, process.stdout, process.stderr):
        if stream is not None:
            stream.close()


def state_of(url: str) -> tuple[int, dict[str, Any]]:
    """Return status and content of the health page."""
    status, text = page(url, "/healthz")
    content: dict[str, Any] = json.loads(text)
    return status, content


# -- loading -----------------------------------------------------------------------------------------------------------


def test_the_state_is_told_while_the_model_loads_and_when_it_is_ready(
    start: Callable[..., Started], fifo: Path
) -> None:
    """In plain HTTP for supervisors, in hello for who announced it, in heartbeats for all; nothing is begun."""
    server = start({"loading": str(fifo)})
    with fifo.open("w"):
        status, state = wait_until(lambda: told(server.url), "the model has printed")
        assert (status, state["state"], state["slots"], state["slots_in_use"]) == (503, "loading", 1, 0)
        assert state["progress"]["seconds"] > 0
        assert state["progress"]["memory_bytes"] > 2**20
        [worker] = state["workers"]
        assert worker["process"] != server.process.pid
        assert worker["memory_bytes"] == pytest.approx(state["progress"]["memory_bytes"], rel=0.5)

        with contextlib.closing(Peer(server.url)) as gone:  # and does not hold the place afterwards
            gone.send("hello")
            assert gone.ask("heartbeat").message_type == "heartbeat_ack"
        patient, modern = Peer(server.url), Peer(server.url)
        held = patient.send("hello")
        greeting = modern.ask("hello", {"capabilities": {"loading": True}})
        assert greeting.message_type == "hello_ack"
        assert (greeting.payload["ok"], greeting.payload["state"]) == (True, "loading")
        assert greeting.payload["progress"]["message"] == "weights 1 of 2"
        assert greeting.payload["capabilities"]["loading"] is True
        for asking in (patient, modern):
            beat = asking.ask("heartbeat")
            assert (beat.payload["state"], beat.payload["progress"]["message"]) == ("loading", "weights 1 of 2")
        refused = modern.ask("infer", {"observation": {}})
        assert (refused.payload["code"], refused.payload["details"]) == ("internal", {"reason": "loading"})
    server.wait_ready()
    assert patient.receive().message_id == held.message_id
    assert modern.ask("hello").payload["details"] == {"reason": "busy"}  # the place went to the one that waited
    status, state = state_of(server.url)
    assert (status, state["state"], state["slots_in_use"], state["connections"]) == (200, "ready", 1, 2)
    assert "progress" not in state
    assert patient.ask("heartbeat").payload == {"ok": True, "state": "ready"}
    patient.close()
    modern.close()


def told(url: str) -> tuple[int, dict[str, Any]] | None:
    """Return the health page once the model has printed."""
    status, state = state_of(url)
    return (status, state) if state["progress"]["message"] == "weights 1 of 2" else None


def test_whoever_waits_for_the_model_is_told_how_far_it_is(start: Callable[..., Started], fifo: Path) -> None:
    """Both clients, of which one is busy until the other has left, and the log, which reports a slow answer, too."""
    server = start({"loading": str(fifo)}, run___PROGRESS_S=0.1, worker___REPORT_S=0.1)
    heard: dict[str, list[Any]] = {"blocking": [], "async": []}
    hasty = {"connect_retry_delay_s": 0.02, "max_connect_attempts": 0}

    def blocking() -> None:
        with Client(server.url, config=hasty, on_loading=heard["blocking"].append) as client:
            heard["blocking"].append(client.infer({"n": 1}))

    async def suspending() -> None:
        async with AsyncClient(server.url, config=hasty, on_loading=heard["async"].append) as client:
            heard["async"].append(await client.infer({"n": 2}))

    threads = [threading.Thread(target=blocking), threading.Thread(target=lambda: asyncio.run(suspending()))]
    with fifo.open("w"):
        for thread in threads:
            thread.start()
        wait_until(lambda: all(heard.values()), "both were told")
        line = server.logs("[server] loading")
        assert re.fullmatch(r"\[server\] loading Subject: \d+ s, \d+ MiB in memory", line)
        server.logs("weights 1 of 2")
    for thread in threads:
        thread.join()
    for name, result in (("blocking", [1]), ("async", [2])):
        *progress, answer = heard[name]
        assert answer == result
        assert all(set(entry) == {"seconds", "memory_bytes", "message"} for entry in progress)
        assert [entry["seconds"] for entry in progress] == sorted(entry["seconds"] for entry in progress)
    with greeted(server.url) as peer:
        peer.send("infer", {"observation": {"n": 4, "fifo": str(fifo)}})
        with fifo.open("w"):
            line = server.logs("the model has been busy for")
            wait_until(lambda: sum("busy for" in line for line in list(server.log)) >= 2, "it is reported again")
        assert re.search(r"for \d+ s \(process \d+, infer\); it is ended after 120 s$", line)
        assert peer.receive().payload["actions"] == [4]


def test_a_client_that_waits_is_told_when_the_model_cannot_be_loaded(start: Callable[..., Started], fifo: Path) -> None:
    """Within the limit for loading: the stack of the worker is in the log, and the server ends."""
    server = start({"loading": str(fifo), "max_connect_seconds": 1.5})
    reason = r"the model could not be loaded within 1\.5 s \(max_connect_seconds\)"
    with fifo.open("w"), pytest.raises(ServerConnectionError, match=f"the policy server ended: {reason}"):
        Client(server.url, config={"connect_retry_delay_s": 0.02})
    assert server.process.wait(DEADLINE_S) == ExitCode.NOT_RUN
    server.logs("in __init__")
    assert re.fullmatch(f"error: Subject: {reason}", server.logs("error: "))


# -- health, metrics and traces of a server at work --------------------------------------------------------------------


@pytest.fixture(scope="module")
def trace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("trace") / "requests.jsonl"


@pytest.fixture(scope="module")
def watched(subject: Path, trace: Path) -> Iterator[RunningServer]:
    """Serve the adapter with everything that operators may ask for."""
    with running_server(subject, options=["--metrics", "--trace", str(trace)]) as server:
        yield server


def metrics(url: str) -> dict[tuple[str, ...], float]:
    """Return the samples of the metrics page by name and labels."""
    status, text = page(url, "/metrics")
    assert status == 200
    families = list(text_string_to_metric_families(text))
    assert all(family.documentation for family in families)
    return {
        (sample.name, *(value for _, value in sorted(sample.labels.items()))): sample.value
        for family in families
        for sample in family.samples
    }


def traced(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_health_is_a_call_too(watched: RunningServer) -> None:
    async def ask() -> dict[str, Any]:
        async with AsyncClient(watched.url) as client:
            return await client.health()

    with Client(watched.url) as client:
        assert client.health()["state"] == "ready"
    assert asyncio.run(ask())["state"] == "ready"


def test_metrics_count_what_happened(watched: RunningServer, fifo: Path) -> None:
    """Requests by method and outcome, bytes, times, and what is going on right now."""
    before = collections.Counter(metrics(watched.url))
    large = {"n": np.zeros(100_000, np.uint8)}
    with Client(watched.url, shared_memory=False) as client:
        client.reset()
        client.infer(large)
        client.infer({"n": 1})
        with pytest.raises(PolicyServerError):
            client.update_obs({"fail": True})
        with pytest.raises(PolicyServerError):
            client.call("no_such_method")
        during = metrics(watched.url)
        assert (during[("xpl_ready",)], during[("xpl_slots",)], during[("xpl_slots_in_use",)]) == (1, 1, 1)
        assert during[("xpl_connections",)] >= 1
        assert during[("xpl_memory_bytes",)] > 2**20
        thread = threading.Thread(target=client.infer, args=({"fifo": str(fifo)},))
        thread.start()
        with fifo.open("w"):
            assert metrics(watched.url)[("xpl_busy_seconds",)] > 0
        thread.join()
    after = collections.Counter(metrics(watched.url))
    after.subtract(before)
    assert after[("xpl_requests_total", "infer", "ok")] == 3
    assert after[("xpl_requests_total", "reset", "ok")] == 1
    assert after[("xpl_requests_total", "update_obs", "call_failed")] == 1
    assert after[("xpl_requests_total", "other", "invalid_frame")] == 1
    assert after[("xpl_model_seconds_count", "infer")] == after[("xpl_wait_seconds_count", "infer")] == 3
    assert 100_000 <= after[("xpl_bytes_total", "in")] < 110_000
    assert 100_000 <= after[("xpl_bytes_total", "out")] < 110_000


def test_refused_requests_are_counted_and_names_do_not_fill_the_memory(watched: RunningServer) -> None:
    """A name that a client makes up is a label only if it could be a method's, and there are few of those."""
    before = len(metrics(watched.url))
    with contextlib.closing(Peer(watched.url)) as peer:
        for number in range(50):
            peer.ask(f"no such type {number}")
            peer.ask(f"made_up_{number}")
            peer.ask("call", {"func_name": f"made_up_{number}"})
    assert len(metrics(watched.url)) - before < 50


def test_each_request_leaves_a_line_in_the_trace(watched: RunningServer, trace: Path) -> None:
    """Who asked for what, the sizes, the phases in milliseconds, and the outcome."""
    begun = len(traced(trace))
    with Client(watched.url, evaluation_id="evaluation", trial_id="trial") as client:
        client.reset()
        client.infer({"n": 1})
        with pytest.raises(PolicyServerError):
            client.infer({"fail": True})
        with pytest.raises(PolicyServerError):
            client.call("undeclared")
    wait_until(lambda: len(traced(trace)) >= begun + 4, "the last request is written down")
    reset, infer, failed, refused = traced(trace)[begun:]
    assert (reset["message_type"], reset["method"], reset["outcome"], reset["step"]) == ("reset", "reset", "ok", 0)
    assert (infer["method"], infer["outcome"], infer["evaluation_id"]) == ("infer", "ok", "evaluation")
    assert (infer["trial_id"], infer["worker"], infer["client"]) == ("trial", 0, 0)
    assert set(infer["ms"]) == {"read", "wait", "model", "send"}
    assert all(0 <= milliseconds < 10_000 for milliseconds in infer["ms"].values())
    assert infer["ms"]["model"] > 0
    assert infer["bytes_in"] > 100
    assert infer["bytes_out"] > 100
    assert (failed["outcome"], failed["step"]) == ("infer_failed", 1)
    assert {key: refused[key] for key in ("message_type", "outcome")} == {
        "message_type": "call",
        "outcome": "invalid_frame",
    }
    assert len({line["message_id"] for line in (reset, infer, failed, refused)}) == 4


def test_the_pages_are_few(subject: Path, serve: Callable[..., RunningServer], watched: RunningServer) -> None:
    """Metrics only where they were asked for; what is no page and no WebSocket is not found."""
    server = serve(subject)
    assert page(server.url, "/healthz?verbose=1")[0] == 200
    for url, path in ((server.url, "/metrics"), (server.url, "/favicon.ico"), (watched.url, "/healthz/x")):
        assert page(url, path)[0] == 404


# -- a model that hangs ------------------------------------------------------------------------------------------------


def test_a_model_that_hangs_is_ended_and_shows_where_it_was(start: Callable[..., Started], fifo: Path) -> None:
    """The client gets `timeout`, the log the stack, and the server ends with the reason."""
    server = start({"request_timeout_s": 0.5})
    server.wait_ready()
    reason = "the model did not answer within 0.5 s"
    with contextlib.closing(Peer(server.url)) as peer:
        hangs = peer.send("infer", {"observation": {"fifo": str(fifo)}})
        waits = peer.send("call", {"func_name": "get_action"})
        answers = {answer.message_id: answer.payload for answer in (peer.receive(), peer.receive())}
        with pytest.raises(ConnectionClosed):
            peer.receive()
    assert [answers[request.message_id]["code"] for request in (hangs, waits)] == ["timeout", "internal"]
    assert all(answer["details"] == {"reason": "worker_died"} for answer in answers.values())
    assert answers[hangs.message_id]["message"] == reason
    assert server.process.wait(DEADLINE_S) == ExitCode.NOT_RUN
    server.logs("in wait")
    server.logs("in update_obs")
    assert server.logs("error: ") == f"error: Subject: {reason}"


# -- the end -----------------------------------------------------------------------------------------------------------


def test_what_runs_is_answered_before_the_end(start: Callable[..., Started], fifo: Path) -> None:
    """After the signal nothing new is begun, nobody new is let in, and the state is told."""
    server = start({})
    server.wait_ready()
    with contextlib.closing(Peer(server.url)) as peer:
        running = peer.send("infer", {"observation": {"n": 3, "fifo": str(fifo)}}, message_id="running")
        with fifo.open("w"):
            server.process.terminate()
            wait_until(lambda: peer.ask("heartbeat").payload["state"] == "draining", "the server drains")
            refused = peer.ask("infer", {"observation": {"n": 4}})
            assert (refused.payload["code"], refused.payload["details"]) == ("internal", {"reason": "shutting_down"})
            with pytest.raises(ConnectionRefusedError):
                Peer(server.url)
            peer.send("infer", {"observation": {}}, message_id="running")  # asked again, not anew
            server.logs("waiting up to 10 s for running requests")
        for _ in range(2):
            answer = peer.receive()
            assert (answer.message_id, answer.payload["actions"]) == (running.message_id, [3])
        with pytest.raises(ConnectionClosed) as closed:
            peer.receive()
        assert closed.value.rcvd is not None
        assert (closed.value.rcvd.code, closed.value.rcvd.reason) == (GOING_AWAY, "the policy server was stopped")
    assert server.process.wait(DEADLINE_S) == 0


def test_the_wait_for_what_runs_is_bounded(start: Callable[..., Started], fifo: Path) -> None:
    """By close_timeout_s; then the model is ended wherever it is."""
    server = start({"close_timeout_s": 0.5})
    server.wait_ready()
    with contextlib.closing(Peer(server.url)) as peer:
        peer.send("infer", {"observation": {"fifo": str(fifo)}})
        with fifo.open("w"):
            began = time.monotonic()
            server.process.terminate()
            assert server.process.wait(DEADLINE_S) == 0
            assert time.monotonic() - began > 0.4


def test_a_second_signal_ends_at_once(start: Callable[..., Started], fifo: Path) -> None:
    """Also if a model is at work, and a client is connected that does not answer when the connection is closed."""
    server = start({"close_timeout_s": 10 * DEADLINE_S})
    server.wait_ready()
    deaf = Raw(server.url)
    with contextlib.closing(deaf), contextlib.closing(Peer(server.url)) as peer:
        peer.send("infer", {"observation": {"fifo": str(fifo)}})
        with fifo.open("w"):
            server.process.send_signal(signal.SIGINT)
            wait_until(lambda: peer.ask("heartbeat").payload["state"] == "draining", "the server drains")
            server.process.send_signal(signal.SIGINT)
            assert server.process.wait(DEADLINE_S) == 0
        assert deaf.receive()[0] == CLOSE
