from __future__ import annotations

import contextlib
import os
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.client.interop.relay import Relay
from tests.support.outside.fake_server import fake_server
from tests.support.peer import DEADLINE_S, Peer, wait_until
from xpl import Client
from xpl import _spec as spec
from xpl.client import (
    ClientError,
    NoOperationError,
    PolicyServerError,
    RequestTimeoutError,
    ServerConnectionError,
    ServerRestartedError,
)
from xpl.observation import ObservationError
from xpl.wire.codec import Frame, WireError
from xpl_cli.serving.launch import RunningServer, running_server

StandIn = Callable[[Callable[[Frame], Any]], tuple[str, list[Frame]]]
HASTE: dict[str, Any] = {
    "connect_retry_delay_s": 0,
    "max_connect_attempts": 2,
    "request_timeout_s": DEADLINE_S,
    "close_timeout_s": 1,
}

COUNTING = """
    import numpy as np
    from xpl import Policy

    class Model(Policy):
        def load(self, config):
            self.runs = 0

        def encode(self, obs, env):
            return obs

        def predict(self, inputs, envs):
            self.runs += 1
            if inputs[0].get("fifo"):
                open(inputs[0]["fifo"]).read()
            return np.array([np.full((2, 8), obs.get("n", 0) + 0.0) for obs in inputs])

        def decode(self, raw, obs, env):
            raw[:, -1] = 0.5
            return super().decode(raw, obs, env)

        def count(self):
            return self.runs
"""


@pytest.fixture(scope="module")
def adapter(write_adapter: Callable[..., Path]) -> Path:
    return write_adapter(COUNTING, methods=["count"], temporal={"chunk": 2})


@pytest.fixture(scope="module")
def shared(adapter: Path) -> Iterator[RunningServer]:
    with running_server(adapter) as server:
        yield server


@pytest.fixture
def relay() -> Iterator[Callable[[str], Relay]]:
    with contextlib.ExitStack() as stack:
        yield lambda url: stack.enter_context(Relay(url))


@pytest.fixture
def stand_in() -> Iterator[StandIn]:
    with contextlib.ExitStack() as stack:
        yield lambda answer: stack.enter_context(fake_server(answer))


def modern(frame: Frame, **answers: Any) -> Any:
    if frame.message_type in answers:
        return answers[frame.message_type]
    if frame.message_type == "hello":
        return frame.answer("hello_ack", {"ok": True, "server": "stand-in", "server_instance_id": "s1"})
    return None


def first_generation(frame: Frame) -> Frame | None:
    """Answer as the servers of July do: no instance id, never an answer to call."""
    if frame.message_type in ("call", "close"):
        return None
    answers = {"hello": "hello_ack", "infer": "infer_result", "reset": "reset_result"}
    actions = {"actions": [{"env": frame.payload.get("observation", {}).get("env_idx")}], "latency_ms": 1.0}
    return frame.answer(answers[frame.message_type], actions if frame.message_type == "infer" else {"ok": True})


# -- the contract over the wire ----------------------------------------------------------------------------------------


def numbers(chunk: Any) -> list[float]:
    return [float(step["arm_joint_state"][0]) for step in chunk]


def test_the_operations_of_the_contract(shared: RunningServer) -> None:
    with Client(shared.url) as client:
        client.reset()
        client.update_obs({"n": 3})
        assert numbers(client.get_action()) == [3, 3]
        assert numbers(client.get_action({"n": 4})) == [4, 4]
        client.update_obs_batch([{"n": 5, "env_idx": 1}, {"n": 6, "env_idx": 0}])
        assert [numbers(chunk) for chunk in client.get_action_batch()] == [[5, 5], [6, 6]]
        assert [numbers(chunk) for chunk in client.get_action_batch([0])] == [[6, 6]]
        assert client.get_action_batch([]) == []
        assert client.call(func_name="reset") is None
        assert client.call(func_name="update_obs", obs={"n": 7}) is None
        assert numbers(client.call(func_name="get_action")) == [7, 7]
        client.call(func_name="update_obs_batch", obs=[{"n": 8}, {"n": 9}])
        assert [numbers(chunk) for chunk in client.call(func_name="get_action_batch", obs=[1, 0])] == [[9, 9], [8, 8]]
        assert client.call("count") > 0
        client.heartbeat()
        assert client.prepare_case("case") is None
        assert client.trial_end({"success": True}) is None
        assert numbers(client.infer({"n": np.int64(2)})) == [2, 2]


def test_errors_of_the_policy_are_raised_and_the_client_goes_on(shared: RunningServer) -> None:
    with Client(shared.url) as client:
        client.reset()
        with pytest.raises(PolicyServerError, match="call_failed: PolicyStateError: get_action needs") as failure:
            client.get_action()
        assert (failure.value.code, failure.value.details) == ("call_failed", {})
        with pytest.raises(NoOperationError, match="_private"):
            client.call("_private")
        with pytest.raises(PolicyServerError, match="invalid_frame"):
            client.call("undeclared")
        with pytest.raises(WireError, match="cannot be sent"):
            client.update_obs({"n": object()})
        assert numbers(client.infer({"n": 1})) == [1, 1]


def test_a_closed_client_says_so(shared: RunningServer) -> None:
    client = Client(shared.url)
    client.close()
    client.close()
    with pytest.raises(ServerConnectionError, match="the client is closed"):
        client.reset()
    Client(shared.url, config={**HASTE, "max_connect_attempts": 1}).close()


def test_a_proxy_of_the_environment_is_not_asked(shared: RunningServer, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("http_proxy", "https_proxy", "all_proxy", "HTTP_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:1")
    monkeypatch.setenv("no_proxy", "")
    Client(shared.url, config=HASTE).close()


# -- connections that fail ---------------------------------------------------------------------------------------------


def test_a_cut_while_the_model_thinks_runs_it_once(
    shared: RunningServer, relay: Callable[[str], Relay], tmp_path: Path
) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    between = relay(shared.url)
    with Client(between.url) as client:
        client.reset()
        before = client.call("count")

        def cut_while_it_thinks() -> None:
            with fifo.open("w"):  # opens when the model waits
                between.cut()

        helper = threading.Thread(target=cut_while_it_thinks)
        helper.start()
        assert numbers(client.infer({"n": 5, "fifo": str(fifo)})) == [5, 5]
        helper.join()
        assert client.call("count") == before + 1


def test_a_cut_between_requests_goes_unnoticed(shared: RunningServer, relay: Callable[[str], Relay]) -> None:
    between = relay(shared.url)
    with Client(between.url) as client:
        client.reset()
        client.update_obs({"n": 6})
        for _ in range(3):
            between.cut()
            assert numbers(client.get_action()) == [6, 6]


def test_another_server_instance_aborts_the_trial(stand_in: StandIn, relay: Callable[[str], Relay]) -> None:
    def instance(name: str) -> str:
        def answer(frame: Frame) -> Frame | None:
            kind = spec.ANSWERS[frame.message_type]
            return kind and frame.answer(kind, {"ok": True, "server_instance_id": name, "result": name})

        return stand_in(answer)[0]

    between = relay(instance("first"))
    with Client(between.url) as client:
        client.reset()
        client.update_obs({"n": 6})
        between.target = instance("second")
        between.cut()
        with pytest.raises(ServerRestartedError, match="restarted"):
            client.get_action()
        client.reset()
        assert client.get_action() == "second"


def test_a_server_that_does_not_come_back_ends_the_request_within_its_timeout(
    stand_in: StandIn, relay: Callable[[str], Relay]
) -> None:
    """Although the limits of a first connection would allow a quarter of an hour."""
    between = relay(stand_in(modern)[0])
    client = Client(between.url, config={"request_timeout_s": 0.5, "connect_retry_delay_s": 0.05})
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))  # bound and not listening: connections are refused
        between.target = f"ws://127.0.0.1:{unused.getsockname()[1]}"
        between.cut()
        started = time.monotonic()
        with pytest.raises(ServerConnectionError, match="no policy server at"):
            client.reset()
        assert time.monotonic() - started < DEADLINE_S
    with pytest.raises(ServerConnectionError, match="the client is closed"):
        client.reset()


@pytest.mark.parametrize(
    "limits",
    [
        {"max_connect_attempts": 3, "max_connect_seconds": 0},
        {"max_connect_attempts": 3, "max_connect_seconds": None},
        {"max_connect_attempts": None, "max_connect_seconds": 0.2},
        {"max_connect_attempts": 0, "max_connect_seconds": 0.2},
    ],
    ids=str,
)
def test_connecting_is_bounded_by_attempts_and_by_time(limits: dict[str, Any]) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        url = f"ws://127.0.0.1:{unused.getsockname()[1]}"
        with pytest.raises(
            ServerConnectionError, match=r"no policy server at ws://127.* after \d+ attempts"
        ) as failure:
            Client(url, config={"connect_retry_delay_s": 0.01, **limits})
    if limits["max_connect_attempts"]:
        assert re.search("after 3 attempts: .*refused", str(failure.value))


def test_a_port_that_says_nothing_does_not_hold_the_client() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"ws://127.0.0.1:{silent.getsockname()[1]}"
        started = time.monotonic()
        with pytest.raises(ServerConnectionError, match="after 2 attempts"):
            Client(url, config={**HASTE, "connect_timeout_s": 0.1})
        with pytest.raises(ServerConnectionError, match="after 1 attempts"):
            Client(url, config={"max_connect_seconds": 0.2, "max_connect_attempts": None})
        assert time.monotonic() - started < DEADLINE_S


def test_something_else_at_the_port_is_not_taken_for_a_server() -> None:
    listener = socket.create_server(("127.0.0.1", 0))

    def answer() -> None:
        for _ in range(2):
            connection, _ = listener.accept()
            connection.recv(65536)
            connection.sendall(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n")
            connection.close()

    thread = threading.Thread(target=answer)
    thread.start()
    with pytest.raises(ServerConnectionError, match=r"after 2 attempts: .*404"):
        Client(f"ws://127.0.0.1:{listener.getsockname()[1]}", config=HASTE)
    thread.join()
    listener.close()


@pytest.mark.parametrize("url", ["localhost:8000", "http://localhost:8000", "ws://", ""])
def test_an_address_that_is_none_is_refused_at_once(url: str) -> None:
    with pytest.raises(ServerConnectionError, match="ws://host:port"):
        Client(url)


def test_a_hello_without_answer_is_tried_again(stand_in: StandIn) -> None:
    """A server that still loads its model holds hello back."""
    url, requests = stand_in(lambda frame: modern(frame) if len(requests) > 3 else None)
    with Client(url, config={**HASTE, "handshake_timeout_s": 0.1, "max_connect_attempts": 0}) as client:
        assert client.server_instance_id == "s1"
    hellos = [frame for frame in requests if frame.message_type == "hello"]
    assert len({frame.message_id for frame in hellos}) == len(hellos) > 1
    assert hellos[0].payload["capabilities"]["wire_version"] == 1


def test_a_busy_server_is_tried_again(shared: RunningServer) -> None:
    other = Client(shared.url)
    with pytest.raises(ServerConnectionError, match=r"after 2 attempts: internal: .*in use"):
        Client(shared.url, config=HASTE)
    waiting: list[Client] = []
    thread = threading.Thread(
        target=lambda: waiting.append(
            Client(shared.url, config={"connect_retry_delay_s": 0.01, "max_connect_attempts": None})
        )
    )
    thread.start()
    probe = Peer(shared.url)
    assert probe.ask("hello").payload["details"] == {"reason": "busy"}
    other.close()
    thread.join()
    assert numbers(waiting[0].infer({"n": 1})) == [1, 1]
    waiting[0].close()
    probe.close()


def test_a_refusal_for_good_is_not_tried_again(stand_in: StandIn) -> None:
    url, requests = stand_in(
        lambda frame: frame.answer("error", {"code": "internal", "message": "go away", "details": "x"})
    )
    with pytest.raises(PolicyServerError, match="internal: go away"):
        Client(url)
    assert [frame.message_type for frame in requests if frame.message_type != "close"] == ["hello"]


def test_a_server_that_failed_says_why_and_is_not_asked_again(stand_in: StandIn) -> None:
    url, requests = stand_in(
        lambda frame: modern(frame, reset=(spec.CLOSE_CODES["server_failed"], "the worker was ended by signal SIGKILL"))
    )
    client = Client(url)
    with pytest.raises(ServerConnectionError, match="policy server ended: the worker was ended by signal SIGKILL"):
        client.reset()
    assert [frame.message_type for frame in requests] == ["hello", "reset"]


def test_a_request_without_answer_ends_the_trial(stand_in: StandIn) -> None:
    url, requests = stand_in(modern)
    client = Client(url, config={"request_timeout_s": 0.2})
    with pytest.raises(RequestTimeoutError, match=r"reset was not answered within 0\.\d s"):
        client.reset()
    with pytest.raises(ServerConnectionError, match="the client is closed"):
        client.reset()
    wait_until(lambda: requests[-1].message_type == "close", "the goodbye arrived")
    assert [frame.message_type for frame in requests] == ["hello", "reset", "close"]


def test_what_is_not_the_answer_is_passed_over(stand_in: StandIn) -> None:
    def answer(frame: Frame) -> Any:
        if frame.message_type != "reset":
            return modern(frame)
        return ["text", Frame("reset_result", "other", {"ok": True}), frame.answer("reset_result", {"ok": True})]

    with Client(stand_in(answer)[0]) as client:
        client.reset()


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (lambda frame: b"\xc1", ClientError, "cannot be understood"),
        (lambda frame: frame.answer("reset_result", {"ok": True}), ClientError, "infer was answered by reset_result"),
        (lambda frame: frame.answer("infer_result", {"latency_ms": 1}), ClientError, "no 'actions'; it has latency_ms"),
        (
            lambda frame: frame.answer("error", {"code": "teapot", "message": "short"}),
            PolicyServerError,
            "internal: short",
        ),
        (lambda frame: frame.answer("error", {}), PolicyServerError, "internal: None"),
    ],
)
def test_a_wrong_answer_is_a_clear_error(
    stand_in: StandIn, answer: Callable[[Frame], Any], error: type[Exception], message: str
) -> None:
    url, _ = stand_in(lambda frame: answer(frame) if frame.message_type == "infer" else modern(frame))
    with Client(url) as client, pytest.raises(error, match=message):
        client.infer({})


def test_a_frame_over_the_limit_is_not_sent(shared: RunningServer, monkeypatch: pytest.MonkeyPatch) -> None:
    with Client(shared.url, shared_memory=False) as client:
        monkeypatch.setitem(spec.LIMITS, "frame_bytes", 100_000)
        with pytest.raises(WireError, match="over the limit"):
            client.infer({"n": 1, "large": np.zeros(100_000, np.uint8)})
        assert numbers(client.infer({"n": 1})) == [1, 1]


# -- servers of the first generation -----------------------------------------------------------------------------------


def test_an_old_server_is_served_by_infer_alone(stand_in: StandIn) -> None:
    url, requests = stand_in(first_generation)
    with Client(url) as client:
        client.reset()
        client.update_obs({"env_idx": 1})
        client.update_obs({"env_idx": 2})
        assert client.get_action() == [{"env": 2}]
        assert client.get_action({"env_idx": 3}) == [{"env": 3}]
    sent = [frame.message_type for frame in requests]
    assert sent[:4] == ["hello", "reset", "infer", "infer"]
    assert "call" not in sent


def test_a_batch_to_an_old_server_is_one_infer_for_each_environment(stand_in: StandIn) -> None:
    with Client(stand_in(first_generation)[0]) as client:
        client.reset()
        client.update_obs_batch([{}, {}, {}])
        assert client.get_action_batch() == [[{"env": 0}], [{"env": 1}], [{"env": 2}]]
        client.update_obs_batch([{"env_idx": 5}, {"env_idx": 3}])
        assert client.get_action_batch([3]) == [[{"env": 3}]]
        assert client.get_action_batch([]) == []
        for wrong in ([4], [3, 3]):
            with pytest.raises(ClientError, match="expected environments out of"):
                client.get_action_batch(wrong)
        with pytest.raises(ClientError, match="exactly one observation"):
            client.get_action()
        with pytest.raises(ClientError, match="first generation"):
            client.call("count")
        client.reset()
        with pytest.raises(ClientError, match="exactly one observation"):
            client.get_action()
        client.update_obs_batch([{"env_idx": 1}, {}])
        with pytest.raises(ObservationError, match="either all"):
            client.get_action_batch()


def test_nothing_is_sent_again_to_an_old_server(stand_in: StandIn) -> None:
    """It has no memory of answers: a second infer would run the model twice."""
    url, requests = stand_in(lambda frame: (1011, "cut") if frame.message_type == "infer" else first_generation(frame))
    client = Client(url)
    with pytest.raises(ServerConnectionError, match="first generation must not be sent twice"):
        client.infer({})
    assert [frame.message_type for frame in requests] == ["hello", "infer"]
    with pytest.raises(ServerConnectionError, match="closed"):
        client.reset()
