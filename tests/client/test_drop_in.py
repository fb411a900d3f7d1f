"""`xpl.Client` in the place of the ecosystem's WsModelClient: its arguments, its names of operations, its refusals.

Sources: XPolicyLab/XPolicyLab, client_server/ws/model_client.py as of July (7198143e) and as of August 2026,
where `call` became a message of its own and the limits became arguments.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.support.outside.fake_server import fake_server
from xpl import Client
from xpl import _spec as spec
from xpl.client import ClientError
from xpl.ecosystem.offered.clients import WsModelClient
from xpl.wire import codec
from xpl.wire.codec import Frame

NAMES = {"evaluation_id": "e", "trial_id": "t", "action_case_id": "c", "repeat_index": 2}
LIMITS = {
    "ws_ping_interval_s": None,
    "ws_ping_timeout_s": 5.0,
    "connect_timeout_s": 30.0,
    "handshake_timeout_s": 60.0,
    "request_timeout_s": 90.0,
    "max_connect_attempts": 1,
    "connect_retry_delay_s": 0.0,
    "max_connect_seconds": 60.0,
    "close_timeout_s": 1.0,
}
Start = Callable[..., tuple[str, list[Frame]]]


@pytest.fixture
def server() -> Iterator[Start]:
    with contextlib.ExitStack() as stack:

        def start(*, is_of_july: bool = False) -> tuple[str, list[Frame]]:
            frames: list[Frame] = []

            def answer(frame: Frame) -> Frame | None:
                if frame.message_type == "close":
                    return None
                frames.append(frame)
                payload: dict[str, Any] = {"ok": True, "actions": ["chunk"], "result": frame.message_type}
                if frame.message_type == "hello" and not is_of_july:
                    payload["server_instance_id"] = "i"
                return frame.answer(spec.ANSWERS[frame.message_type], payload)

            return stack.enter_context(fake_server(answer))[0], frames

        yield start


def test_every_argument_of_the_field_is_taken_and_every_frame_bears_the_names(server: Start) -> None:
    url, frames = server()
    with Client(url=url, **NAMES, **LIMITS, client=None) as client:
        client.call(func_name="reset")
        assert {name: getattr(client, name) for name in NAMES} == NAMES
        client.trial_id, client.action_case_id, client.repeat_index = "t2", "c2", 3
        client.call(func_name="get_action")
    told = [(frame.evaluation_id, frame.trial_id, frame.action_case_id, frame.repeat_index) for frame in frames]
    assert told == [("e", "t", "c", 2), ("e", "t", "c", 2), ("e", "t2", "c2", 3)]
    assert frames[1].payload["trial_id"] == "t"


@pytest.mark.parametrize("is_of_july", [False, True])
def test_call_knows_every_operation_of_the_wire(server: Start, *, is_of_july: bool) -> None:
    """Also of a server that knows no `call`; what the field hands over as obs is the payload."""
    url, frames = server(is_of_july=is_of_july)
    with Client(url, **NAMES) as client:
        assert client.call("prepare_case", obs={"task_name": "stack"}) == "prepare_case"
        assert client.call("reset", obs={"task_name": "stack", "seed": 3}) == "reset"
        client.call("update_obs", obs={"n": 1})
        client.call("get_action")
        assert client.call("infer", obs={"n": 2}) == ["chunk"]
        assert client.call("get_action", obs={"n": 3}) == ["chunk"]
        assert client.call("heartbeat")["ok"] is True
        assert client.call("trial_end", obs={"success": True}) == "trial_end"
    told = {frame.message_type: frame.payload for frame in frames}
    assert told["prepare_case"] == {"action_case_id": "c", "task_name": "stack"} | _counted(told["prepare_case"])
    assert told["reset"] == {"trial_id": "t", "task_name": "stack", "seed": 3} | _counted(told["reset"])
    assert told["trial_end"] == {"trial_id": "t", "success": True} | _counted(told["trial_end"])
    assert told["infer"]["observation"] == {"n": 3}
    assert ("call" in told) is not is_of_july


def _counted(payload: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in payload.items() if key == "sequence"}


@pytest.mark.parametrize(
    ("arguments", "kind"),
    [
        ({"func_name": None}, NotImplementedError),
        ({"func_name": ""}, NotImplementedError),
        ({"func_name": "_private"}, NotImplementedError),
        ({"func_name": "trial_end", "obs": [1]}, TypeError),
        ({"func_name": "reset", "obs": "now"}, TypeError),
        ({"func_name": "prepare_case", "obs": 3}, TypeError),
        ({"func_name": "get_action_batch", "env_idx_list": [0]}, TypeError),
    ],
)
def test_what_would_be_lost_is_refused(server: Start, arguments: dict[str, Any], kind: type) -> None:
    url, frames = server()
    with Client(url, **NAMES) as client, pytest.raises(kind):
        client.call(**arguments)
    assert [frame.message_type for frame in frames] == ["hello"]


def test_a_case_is_needed_before_it_is_announced(server: Start) -> None:
    url, frames = server()
    with Client(url) as client:
        with pytest.raises(ValueError, match="action_case_id"):
            client.call("prepare_case")
        client.prepare_case("c9", task_name="stack")
        client.reset()
    assert [frame.action_case_id for frame in frames] == [None, "c9", "c9"]


@pytest.mark.parametrize("name", [{"trial_id": 3}, {"action_case_id": 1.5}, {"repeat_index": "2"}])
def test_a_name_that_servers_drop_is_refused(server: Start, name: dict[str, Any]) -> None:
    url, frames = server()
    with pytest.raises(codec.WireError, match=next(iter(name))):
        Client(url, **name)
    assert frames == []


def test_limits_by_name_go_before_those_of_a_configuration(server: Start) -> None:
    url, _ = server()
    config = {"request_timeout_s": 7, "close_timeout_s": 8, "ws_ping_interval_s": 9, "ws_ping_timeout_s": 10}
    with Client(url, config=config, close_timeout_s=1, request_timeout_s=None, ws_ping_interval_s=None) as client:
        used = client._conversation._exchange._config
        assert [used[name] for name in config] == [7, 1, None, 10]


def test_a_client_that_is_connected_can_be_handed_over(server: Start) -> None:
    url, frames = server()
    with Client(url, trial_id="t7") as first:
        second = Client("", client=first)
        second.reset()
        assert second.trial_id == "t7"
        assert WsModelClient(client=first).call("heartbeat")["ok"] is True
    assert [frame.message_type for frame in frames] == ["hello", "reset", "heartbeat"]
    with pytest.raises(TypeError, match=r"must be a connected xpl\.Client"):
        Client("", client=object())
    with pytest.raises(ClientError):
        second.reset()


def test_the_client_that_loops_import_hands_all_of_it_on(server: Start) -> None:
    url, frames = server()
    with WsModelClient(url, **NAMES, **LIMITS) as client:
        client.call(func_name="reset")
    assert {frame.trial_id for frame in frames} == {"t"}
    assert {frame.action_case_id for frame in frames} == {"c"}
