"""Our clients with the oldest and the newest libraries that they allow, and against a server on msgpack-numpy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.client.interop.build import ROOT
from tests.client.interop.driver import Driver, PeerError, environment
from tests.client.interop.relay import Relay
from xpl import Client
from xpl_cli.serving.launch import RunningServer

Serve = Callable[..., RunningServer]
Connect = Callable[..., Driver]
VALUES = [
    np.arange(12, dtype=np.float32).reshape(3, 4),
    np.arange(6, dtype=np.float64)[::2],
    np.asfortranarray(np.arange(6, dtype=np.int64).reshape(2, 3)),
    np.array([1, 2], dtype=">f4"),
    np.array([1.5, -0.0, np.inf], dtype=np.float16),
    np.array([True, False]),
    np.zeros((0, 7), dtype=np.float32),
    np.array(3, dtype=np.uint16),
    np.array(["left", "right"]),
    np.array([b"raw"]),
    np.array([(1, 2.5)], dtype=[("step", "<i4"), ("reward", "<f8")]),
    np.array([1 + 2j], dtype=np.complex64),
    np.float32(0.1),
    np.uint8(7),
    np.bool_(True),
    1 - 2j,
    [1, 2.5, "text", None, b"bytes", {"nested": [np.int8(-1)]}],
]


@pytest.mark.parametrize("peers", [environment("oldest")], indirect=True)
def test_the_oldest_environment_has_the_oldest_websockets(peers: Path, start: Connect) -> None:
    """What runs is what the SDK declares as its lower bound, and the numpy that simulators pin."""
    versions = start(peers, "client_driver.py", PYTHONPATH=str(ROOT)).ask("versions")
    assert versions["websockets"] == "12.0"
    assert versions["numpy"].startswith("1.")


@pytest.mark.sampled(1)
@pytest.mark.parametrize("envs", [1, 3])
def test_our_client_plays_whole_episodes(serve: Serve, client: Connect, envs: int) -> None:
    overrides = {"env_cfg_type": "franka_single"}
    ours = client(serve(ROOT / "policy/demo_policy", overrides=overrides).url)
    assert ours.ask("play", episodes=3, steps=4, envs=envs) == 3 * 4 * 16 * envs
    assert ours.ask("infer") == 16
    ours.ask("heartbeat")
    with pytest.raises(PeerError) as refused:
        ours.ask("call", func_name="dance")
    assert refused.value.kind == "PolicyServerError"
    ours.ask("close")


@pytest.mark.sampled(1)
def test_our_client_survives_a_cut(serve: Serve, client: Connect) -> None:
    server = serve(ROOT / "policy/demo_policy", overrides={"env_cfg_type": "franka_single"})
    with Relay(server.url) as relay:
        ours = client(relay.url)
        ours.start("play", episodes=2, steps=3, envs=1, pause=[0, 2])
        ours.receive()
        relay.cut()
        ours.send({})
        assert ours.result() == 2 * 3 * 16
        ours.ask("close")


@pytest.mark.sampled(1)
def test_our_client_notices_a_restart(serve: Serve, client: Connect) -> None:
    overrides = {"env_cfg_type": "franka_single"}
    with Relay(serve(ROOT / "policy/demo_policy", overrides=overrides).url) as relay:
        ours = client(relay.url)
        ours.start("play", episodes=1, steps=3, envs=1, pause=[0, 1])
        ours.receive()
        relay.target = serve(ROOT / "policy/demo_policy", overrides=overrides).url
        relay.cut()
        ours.send({})
        with pytest.raises(PeerError) as restarted:
            ours.result()
        assert restarted.value.kind == "ServerRestartedError"


@pytest.mark.sampled(1)
def test_a_script_that_forgets_close_ends(serve: Serve, client: Connect) -> None:
    """An episode that dies by an exception must not leave a process behind, whatever threads the library starts."""
    ours = client(serve(ROOT / "policy/demo_policy", overrides={"env_cfg_type": "franka_single"}).url)
    ours.ask("play", episodes=1, steps=1, envs=1)
    assert ours.end() == 0


def test_every_array_crosses_to_msgpack_numpy_and_back(peers: Path, start: Connect) -> None:
    server = start(peers, "msgpack_numpy_server.py")
    with Client(server.ask("start")) as ours:
        assert ours.server_instance_id is None  # of the first generation
        ours.reset()
        chunk = ours.infer({"values": VALUES})
        ours.heartbeat()
    for value, action in zip(VALUES, chunk, strict=True):
        assert_same(action["echo"], value)
        if isinstance(value, np.ndarray):
            described = value.dtype.str, list(value.shape), value.tobytes().hex()
            assert action["seen"] == ["array", *described]


def assert_same(got: Any, sent: Any) -> None:
    if isinstance(sent, (np.ndarray, np.generic)):
        assert type(got) is type(sent)
        assert got.dtype == sent.dtype
        assert got.shape == sent.shape
        assert got.tobytes() == sent.tobytes()
    else:
        assert got == sent
        assert type(got) is type(sent)
