from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.outside.fake_server import fake_server
from tests.support.peer import xpl
from xpl import Client
from xpl.client import AsyncClient, ClientError, EnvironmentMismatchError, PolicyServerError
from xpl_cli.basics.errors import ExitCode
from xpl_cli.serving.launch import RunningServer, running_server

if TYPE_CHECKING:
    from xpl.wire.codec import Frame

SUBJECT = """
    class Model:
        def __init__(self, config):
            self.runs = 0

        def infer(self, observation):
            self.runs += 1
            return [self.runs]
"""
MANIFEST: dict[str, Any] = {
    "embodiments": ["franka_single", "piper"],
    "action_types": ["joint"],
    "control_frequency": 20,
    "inputs": {"required": ["instruction", "vision.cam_head"], "optional": ["vision.cam_wrist"]},
}
FITTING: dict[str, Any] = {
    "embodiment": "franka_single",
    "action_type": "joint",
    "control_frequency": 20.0,
    "inputs": ["vision.cam_third_view", "vision.cam_head", "instruction"],
}
MISMATCHES: list[tuple[dict[str, Any], list[str]]] = [
    ({"embodiment": "unicycle"}, ["embodiment"]),
    ({"action_type": "ee", "control_frequency": 10, "inputs": []}, ["action_type", "control_frequency", "inputs"]),
]
"""What differs from the environment above; tests/client/test_agreement.py has each difference and its sentence."""


@pytest.fixture(scope="module")
def shared(write_adapter: Callable[..., Path]) -> Iterator[RunningServer]:
    """Serve an adapter that says what it needs."""
    with running_server(write_adapter(SUBJECT, **MANIFEST)) as server:
        yield server


@pytest.mark.parametrize(("change", "fields"), MISMATCHES)
def test_an_environment_that_does_not_fit_is_refused_before_the_first_step(
    shared: RunningServer, change: dict[str, Any], fields: list[str]
) -> None:
    """With every difference, at once: neither client tries again, and no place is taken."""
    environment = {**FITTING, **change}
    with pytest.raises(EnvironmentMismatchError, match="policy and environment do not fit: ") as refusal:
        Client(shared.url, environment=environment)
    assert isinstance(refusal.value, PolicyServerError)
    assert (refusal.value.code, refusal.value.details["reason"]) == ("invalid_frame", "mismatch")
    differences = refusal.value.details["differences"]
    assert [one["field"] for one in differences] == fields
    for one in differences:
        assert set(one) == {"field", "policy", "environment", "message"}
        assert one["environment"] == environment[one["field"]]

    async def connect() -> None:
        async with AsyncClient(shared.url, environment=environment):
            pass

    with pytest.raises(EnvironmentMismatchError) as again:
        asyncio.run(connect())
    assert again.value.details == refusal.value.details
    Client(shared.url, environment=FITTING, config={"max_connect_attempts": 1}).close()


@pytest.mark.parametrize("environment", [FITTING, None, {**FITTING, "embodiment": None, "inputs": None, "more": 1}])
def test_an_environment_that_fits_is_served(shared: RunningServer, environment: dict[str, Any] | None) -> None:
    """What one side does not say is not compared; the client can read what the policy needs."""
    with Client(shared.url, environment=environment) as client:
        assert client.infer({})
        assert client.policy["name"] == "Subject"
        assert client.policy["embodiment"] == "franka_single"
        assert client.policy["inputs"] == MANIFEST["inputs"]["required"]
        assert client.policy["control_frequency"] == 20


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("env_cfg_type=arx_x5", "declares the embodiments franka_single, piper, got env_cfg_type: arx_x5"),
        ("action_type=ee", "declares the action types joint, got action_type: ee"),
    ],
)
def test_what_the_manifest_does_not_declare_is_not_served(
    write_adapter: Callable[..., Path], tmp_path: Path, setting: str, said: str
) -> None:
    """Also by an adapter that would take it without a word: one error, and nothing is started."""
    run = xpl("serve", str(write_adapter(SUBJECT, **MANIFEST)), "--port", "0", "--set", setting, cwd=tmp_path)
    assert (run.returncode, run.stdout) == (ExitCode.USAGE, "")
    assert said in run.stderr
    assert "Traceback" not in run.stderr


def test_what_the_manifest_leaves_open_is_not_compared(
    write_adapter: Callable[..., Path], serve: Callable[..., RunningServer]
) -> None:
    """Of an adapter without a manifest, its configuration is all that is known; a robot may go by another name."""
    server = serve(write_adapter(SUBJECT), overrides={"env_cfg_type": "dual_x5"})
    for name in ("arx_x5", "dual_x5"):
        environment = {**FITTING, "embodiment": name, "control_frequency": 3, "inputs": []}
        with Client(server.url, environment=environment) as client:
            assert client.infer({})
            assert client.policy["embodiment"] == "arx_x5"
    with pytest.raises(EnvironmentMismatchError, match="started for embodiment arx_x5, the environment has franka"):
        Client(server.url, environment=FITTING)


def test_the_client_compares_where_the_server_does_not() -> None:
    """A server of another make may tell what its policy needs and leave the comparison to others."""
    payload = {"ok": True, "server": "other", "server_instance_id": "s1"}
    payload["policy"] = {"embodiment": "piper", "action_types": ["ee"]}

    def answer(frame: Frame) -> Frame | None:
        return frame.answer("hello_ack", payload) if frame.message_type == "hello" else None

    with fake_server(answer) as (url, requests):
        with pytest.raises(EnvironmentMismatchError) as refusal:
            Client(url, environment=FITTING)
        assert [one["field"] for one in refusal.value.details["differences"]] == ["embodiment", "action_type"]
        assert isinstance(refusal.value, ClientError)
        Client(url, environment={"embodiment": "piper", "action_type": "ee"}).close()
    kinds = [frame.message_type for frame in requests]
    assert kinds.count("hello") == 2
    assert set(kinds) <= {"hello", "close"}
