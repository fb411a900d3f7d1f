from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support.outside.chaos import Fault, Proxy
from tests.support.outside.fake_server import fake_server
from tests.support.outside.raw import page
from tests.support.peer import Peer, wait_until
from xpl import Client, image_codec
from xpl import _spec as spec
from xpl.client import (
    AsyncClient,
    ClientError,
    PolicyServerError,
    RequestTimeoutError,
    ServerConnectionError,
    ServerFailedError,
)
from xpl.wire import segment
from xpl.wire.codec import WireError
from xpl_cli.serving.launch import RunningServer, running_server

if TYPE_CHECKING:
    from xpl.wire.codec import Frame

# Keeps every observation of the episode, as an adapter with a history does.
SUBJECT = """
    import zlib
    import numpy as np


    class Model:
        def __init__(self, config):
            self.held = []

        def update_obs(self, obs):
            if obs.get("fifo"):
                with open(obs["fifo"]) as pipe:
                    pipe.read()
            if obs.get("fail"):
                raise ValueError("the gripper is unhappy")
            self.held.append(obs)

        def update_obs_batch(self, obs_list):
            self.held.extend(obs_list)

        def get_action(self):
            if not self.held:
                raise ValueError("nothing was observed")
            return [obs.get("n") for obs in self.held]

        def get_action_batch(self, env_idx_list=None):
            return [[env] for env in env_idx_list or range(2)]

        def reset(self):
            self.held = []

        def prepare_case(self, case):
            return case

        def on_trial_end(self, result):
            return result

        def sums(self):
            return [zlib.crc32(np.ascontiguousarray(obs["vision"]["cam_head"]["color"])) for obs in self.held]

        def vision(self):
            return self.held[-1]["vision"]

        def echo(self, value):
            return value
"""
HASTE: dict[str, Any] = {"connect_retry_delay_s": 0.02, "max_connect_attempts": 0}
SHAPE = (240, 320, 3)
SIZE = 240 * 320 * 3


@pytest.fixture(scope="module")
def subject(write_adapter: Callable[..., Path]) -> Path:
    return write_adapter(SUBJECT, methods=["sums", "vision", "echo"])


@pytest.fixture(scope="module")
def trace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("trace") / "requests.jsonl"


@pytest.fixture(scope="module")
def shared(subject: Path, trace: Path) -> Iterator[RunningServer]:
    with running_server(subject, {"close_timeout_s": 0.5}, options=["--trace", str(trace)]) as server:
        yield server


@pytest.fixture
def fifo(tmp_path: Path) -> Path:
    path = tmp_path / "fifo"
    os.mkfifo(path)
    return path


def picture(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, SHAPE, np.uint8)


def seen(seed: int = 0, **entries: Any) -> dict[str, Any]:
    return {"vision": {"cam_head": {"color": picture(seed)}}, **entries}


def sizes(trace: Path, method: str) -> list[int]:
    lines = map(json.loads, trace.read_text(encoding="utf-8").splitlines())
    return [line["bytes_in"] for line in lines if line.get("method") == method]


def workers(server: RunningServer) -> list[int]:
    return [worker["process"] for worker in json.loads(page(server.url, "/healthz")[1])["workers"]]


def opened(pid: int) -> int:
    """Return how many segments a process has open."""
    found = 0
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed meanwhile
            found += str(entry.readlink()).startswith(f"{segment.folder()}/xpl-")
    return found


def touched(pid: int) -> int:
    maps = Path(f"/proc/{pid}/smaps").read_text(encoding="utf-8")
    return 1024 * sum(map(int, re.findall(rf"{segment.folder()}/xpl-.*\nSize:.*\n(?:.*\n)*?Rss: +(\d+) kB", maps)))


# -- shared memory -----------------------------------------------------------------------------------------------------


def test_large_arrays_do_not_travel_in_the_message(shared: RunningServer, trace: Path) -> None:
    with Client(shared.url) as client:
        client.reset()
        before = len(sizes(trace, "update_obs")), len(sizes(trace, "update_obs_batch"))
        client.update_obs(seen(1, state={"arm_joint_state": np.arange(7.0)}, instruction="x" * 1000))
        client.update_obs_batch([seen(seed, env_idx=seed) for seed in range(3)])
        assert client.call("sums") == [zlib.crc32(picture(seed)) for seed in (1, 0, 1, 2)]
        assert client.call("vision")["cam_head"]["color"].dtype == np.uint8
    (single,) = sizes(trace, "update_obs")[before[0] :]
    (batch,) = sizes(trace, "update_obs_batch")[before[1] :]
    assert 1000 < single < 3000
    assert batch < 3000


def test_who_does_not_wish_it_sends_all(shared: RunningServer, trace: Path) -> None:
    for wishes in ({"shared_memory": False}, {"packed": False}):
        with Client(shared.url, **wishes) as client:
            assert "shared_memory" not in client.capabilities
            client.reset()
            client.update_obs(seen(2))
            assert client.call("sums") == [zlib.crc32(picture(2))]
        assert SIZE < sizes(trace, "update_obs")[-1] < SIZE + 2000


def test_what_a_history_holds_stays_as_it_was(shared: RunningServer) -> None:
    expected = []
    with Client(shared.url) as client:
        for episode in range(2):
            client.reset()
            expected = [zlib.crc32(picture(seed)) for seed in range(episode, episode + 30)]
            for seed in range(episode, episode + 30):
                client.update_obs(seen(seed))
                client.call("echo", {"x": picture(99)})  # used for a moment only
            assert client.call("sums") == expected
        assert (
            SIZE <= touched(os.getpid()) < 8 * SIZE
        )  # 120 pictures were sent; those that are held are the worker's own


def test_a_goodbye_gives_the_memory_back(shared: RunningServer) -> None:
    (worker,) = workers(shared)
    for _ in range(3):
        with Client(shared.url, config=HASTE) as client:
            client.reset()
            client.update_obs(seen())
            assert opened(worker) >= 1
            client.reset()
    wait_until(lambda: opened(worker) == 0, "the worker has let go")


def test_memory_that_the_client_cannot_see_is_done_without(
    shared: RunningServer, trace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise segment.SegmentError("no such file")

    monkeypatch.setattr(segment.Arena, "__init__", refuse)
    with Client(shared.url) as client:
        client.reset()
        client.update_obs(seen(3))
        assert client.call("sums") == [zlib.crc32(picture(3))]
        path = Path(client.capabilities["shared_memory"]["path"])
    assert sizes(trace, "update_obs")[-1] > SIZE
    wait_until(lambda: not path.exists(), "the offer is gone")


def test_memory_that_the_server_cannot_make_is_done_without(subject: Path, serve: Callable[..., RunningServer]) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 26, limits[1]))
    try:
        server = serve(subject)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    with Client(server.url) as client:
        assert "shared_memory" not in client.capabilities
        client.reset()
        client.update_obs(seen(3))
        assert client.call("sums") == [zlib.crc32(picture(3))]
    assert any("no room for shared memory" in line for line in server.log)
    assert not [path for path in segment.folder().glob("xpl-*") if owned(path, server.pid)]


def owned(path: Path, pid: int) -> bool:
    with contextlib.suppress(OSError):
        return any(link.resolve() == path for link in Path(f"/proc/{pid}/fd").iterdir())
    return False


CRASHING = """
import sys, numpy as np, xpl
client = xpl.Client(sys.argv[1])
client.reset()
client.update_obs({"vision": {"cam_head": {"color": np.zeros((480, 640, 3), np.uint8)}}})
print(client.capabilities["shared_memory"]["path"], flush=True)
sys.stdin.read()
"""


@pytest.mark.sampled(1)
@pytest.mark.parametrize("victim", ["client", "worker", "front end"])
def test_nothing_is_left_after_a_kill(subject: Path, serve: Callable[..., RunningServer], victim: str) -> None:
    """The memory has no name any more once both sides have proved that they see it."""
    server = serve(subject, overrides={"close_timeout_s": 0.2})
    (worker,) = workers(server)
    process = subprocess.Popen(
        [sys.executable, "-c", CRASHING, server.url], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with process:
        assert process.stdout is not None
        path = Path(process.stdout.readline().strip())
        os.kill({"client": process.pid, "worker": worker, "front end": server.pid}[victim], signal.SIGKILL)
        if victim == "client":
            with Client(server.url, config=HASTE) as client:
                client.reset()
                client.update_obs(seen(4))
                assert client.call("sums") == [zlib.crc32(picture(4))]
                client.reset()
            wait_until(lambda: opened(worker) == 0, "the worker has let go")
    assert path.parent == segment.folder()
    assert not path.exists()


LEAVING = """
import os, signal
from xpl.wire.segment import Segment
print(Segment().path, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_server_has_left_is_swept_by_the_next_one(
    subject: Path, serve: Callable[..., RunningServer]
) -> None:
    left = subprocess.run([sys.executable, "-c", LEAVING], capture_output=True, text=True, check=False)
    path = Path(left.stdout.strip())
    assert path.parent == segment.folder()
    serve(subject)
    assert not path.exists()


# -- JPEG --------------------------------------------------------------------------------------------------------------


def smooth() -> np.ndarray:
    ramp = np.linspace(0, 255, SHAPE[1]).astype(np.uint8)
    image = np.zeros(SHAPE, np.uint8)
    image[..., 0], image[..., 2] = ramp, ramp[::-1]
    return image


def test_chosen_cameras_travel_as_jpeg_and_the_others_as_they_are(shared: RunningServer, trace: Path) -> None:
    noise, ramp = picture(5), smooth()
    obs = {"vision": {name: {"color": ramp, "depth": noise[..., :1]} for name in ("cam_head", "cam_wrist")}}

    def check(vision: Any) -> None:
        assert np.array_equal(vision["cam_wrist"]["color"], ramp)
        arrived = vision["cam_head"]["color"].astype(int)
        assert 0 < np.abs(arrived - ramp).max() < 12
        assert all(np.array_equal(camera["depth"], noise[..., :1]) for camera in vision.values())

    async def other_client() -> None:
        async with AsyncClient(shared.url, jpeg={"cam_head": 90}, config=HASTE) as client:
            await client.reset()
            await client.update_obs(obs)
            check(await client.call("vision"))

    with Client(shared.url, jpeg={"cam_head": 90, "cam_third_view": 90}) as client:
        client.reset()
        for update in (client.update_obs, lambda given: client.update_obs_batch([given, given]), client.infer):
            update(obs)
            check(client.call("vision"))
    asyncio.run(other_client())
    sent = []
    for quality in (20, 95):
        with Client(shared.url, jpeg={"cam_head": quality}, config=HASTE) as client:
            client.infer({"vision": {"cam_head": picture(6)}})  # directly under the camera's name, as some write it
            assert client.call("vision")["cam_head"].shape == SHAPE
            sent.append(sizes(trace, "infer")[-1])
    assert sent[0] < sent[1] < SIZE


def test_pictures_that_are_encoded_already_stay_so(shared: RunningServer) -> None:
    ramp = smooth()
    for camera in (image_codec.encode_png(ramp), np.frombuffer(image_codec.encode_png(ramp), np.uint8)):
        with Client(shared.url, jpeg={"cam_head": 10}, config=HASTE) as client:
            client.reset()
            client.update_obs({"vision": {"cam_head": {"color": camera}}})
            assert np.array_equal(client.call("vision")["cam_head"]["color"], ramp)


def test_a_server_that_does_not_know_the_marker_gets_pixels() -> None:
    """It would take red for blue."""
    payloads = {"hello": {"ok": True, "server": "other", "server_instance_id": "s1"}}
    payloads["infer"] = {"actions": [1], "latency_ms": 1.0}

    def answer(frame: Frame) -> Frame | None:
        kind = frame.message_type
        return frame.answer(str(spec.ANSWERS[kind]), payloads[kind]) if kind in payloads else None

    with fake_server(answer) as (url, requests), Client(url, jpeg={"cam_head": 50}) as client:
        client.infer(seen(7))
        observation = next(frame.payload["observation"] for frame in requests if frame.message_type == "infer")
        assert np.array_equal(observation["vision"]["cam_head"]["color"], picture(7))


# -- updates that are sent ahead ---------------------------------------------------------------------------------------


def test_updates_are_sent_ahead_in_order(shared: RunningServer, fifo: Path) -> None:
    with Client(shared.url, pipelined=True) as client:
        client.reset()
        client.update_obs({"n": 0, "fifo": str(fifo)})
        for n in range(1, spec.LIMITS["pipelined"]):
            client.update_obs(seen(n, n=n))
        with fifo.open("w"):
            pass
        for n in range(spec.LIMITS["pipelined"], 50):
            client.update_obs(seen(n, n=n))
        assert client.get_action() == list(range(50))


def test_the_number_of_updates_ahead_is_bounded(shared: RunningServer, fifo: Path) -> None:
    with Client(shared.url, pipelined=True) as client:
        client.reset()
        sent: list[int] = []

        def send() -> None:
            for n in range(spec.LIMITS["pipelined"] + 3):
                client.update_obs({"n": n, "fifo": str(fifo) if n == 0 else None})
                sent.append(n)

        thread = threading.Thread(target=send)
        thread.start()
        with fifo.open("w"):
            wait_until(lambda: len(sent) == spec.LIMITS["pipelined"], "the window is full")
            wait_until(lambda: f'"waiting": {len(sent) - 1}' in page(shared.url, "/healthz")[1], "they wait in line")
            assert len(sent) == spec.LIMITS["pipelined"]
        thread.join()
        assert client.get_action() == list(range(spec.LIMITS["pipelined"] + 3))


def follow(client: Client, operation: str) -> None:
    if operation == "update_obs":
        for n in range(spec.LIMITS["pipelined"] + 1):
            client.update_obs({"n": n})
    else:
        getattr(client, operation)()


@pytest.mark.parametrize("following", ["get_action", "update_obs", "settle", "reset"])
def test_an_update_that_failed_is_reported_by_what_comes_next(shared: RunningServer, following: str) -> None:
    with Client(shared.url, pipelined=True, config=HASTE) as client:
        client.reset()
        client.update_obs({"n": 1, "fail": True})
        with pytest.raises(PolicyServerError, match="call_failed: ValueError: the gripper is unhappy"):
            follow(client, following)
        client.settle()
        client.reset()
        client.update_obs({"n": 2})
        assert client.get_action() == [2]


@pytest.mark.parametrize("following", ["get_action", "update_obs", "settle"])
def test_an_update_that_is_not_answered_in_time_ends_the_trial(
    shared: RunningServer, fifo: Path, following: str
) -> None:
    """Whatever waits for it; it is not taken for a lost connection and sent again."""
    client = Client(shared.url, pipelined=True, config={**HASTE, "request_timeout_s": 0.3})
    client.reset()
    client.update_obs({"fifo": str(fifo)})
    with fifo.open("w"):
        with pytest.raises(RequestTimeoutError, match="not answered"):
            follow(client, following)
        with pytest.raises(ServerConnectionError, match="the client is closed"):
            client.get_action()


def test_an_update_that_cannot_be_sent_leaves_no_gap(shared: RunningServer) -> None:
    with Client(shared.url, pipelined=True, config=HASTE) as client:
        client.reset()
        client.update_obs({"n": 1})
        with pytest.raises(WireError, match="cannot be sent"):
            client.update_obs({"n": object()})
        client.update_obs({"n": 2})
        assert client.get_action() == [1, 2]


def test_a_missing_or_repeated_update_is_found_out(shared: RunningServer) -> None:
    with contextlib.closing(Peer(shared.url)) as peer:
        announced = {"capabilities": {"sequence": True}}
        wait_until(lambda: peer.ask("hello", announced).message_type == "hello_ack", "the server is free")

        def update(number: int) -> dict[str, Any]:
            payload = {"func_name": "update_obs", "obs": {"n": number}, "sequence": number}
            return dict(peer.ask("call", payload).payload)

        assert update(0)["ok"] is True
        for wrong in (2, 0, -1, "1"):
            refused = update(wrong)  # type: ignore[arg-type]
            assert (refused["code"], refused["details"]) == ("internal", {"reason": "out_of_order"})
        assert update(1)["ok"] is True
        assert peer.ask("call", {"func_name": "get_action", "sequence": 2}).payload["result"] == [0, 1]
        peer.send("close")


@pytest.mark.parametrize("direction", ["request", "answer"])
def test_a_cut_with_updates_ahead_loses_and_repeats_nothing(shared: RunningServer, direction: str) -> None:
    with (
        Proxy(int(shared.url.rpartition(":")[2])) as proxy,
        Client(proxy.url, pipelined=True, shared_memory=False, config=HASTE) as client,
    ):
        client.reset()
        for n in range(20):
            if n in (5, 12):
                proxy.arm([Fault(f"cut_{'after' if n == 5 else 'before'}", direction)])
            client.update_obs({"n": n})
        assert client.get_action() == list(range(20))


def observe_much(client: Client) -> None:
    for seed in range(spec.LIMITS["pipelined"] + 1):
        client.update_obs(seen(seed))


def test_a_cut_with_updates_ahead_in_shared_memory_is_loud(shared: RunningServer, fifo: Path) -> None:
    with Proxy(int(shared.url.rpartition(":")[2])) as proxy:
        client = Client(proxy.url, pipelined=True, config=HASTE)
        client.reset()
        client.update_obs({"fifo": str(fifo)})
        with fifo.open("w"):
            proxy.arm([Fault("cut_after", "request")])
            with pytest.raises(ServerConnectionError, match="while pipelined updates were in shared memory"):
                observe_much(client)
        with pytest.raises(ServerConnectionError, match="the client is closed"):
            client.get_action()


# -- the client for asyncio --------------------------------------------------------------------------------------------


def test_the_async_client_has_every_operation(shared: RunningServer) -> None:
    async def scenario() -> None:
        client = AsyncClient(shared.url, trial_id="t", config=HASTE)
        await client.connect()
        assert client.server_instance_id
        assert client.capabilities["wire_version"] == 1
        assert client.policy["name"] == "Subject"
        await client.reset()
        await client.update_obs(seen(8, n=8))
        assert await client.get_action() == [8]
        assert await client.get_action({"n": 9}) == [8, 9]
        await client.update_obs_batch([{"n": 10}, {"n": 11}])
        assert await client.get_action_batch([1, 0]) == [[1], [0]]
        assert await client.get_action_batch() == [[0], [1]]
        assert await client.infer({"n": 12}) == [8, 9, 10, 11, 12]
        assert await client.prepare_case("case", colour="red") == {"action_case_id": "case", "colour": "red"}
        assert await client.trial_end({"success": True}) == {"trial_id": "t", "success": True}
        assert await client.call("echo", [1, "two"]) == [1, "two"]
        await client.call("reset")
        await client.call("update_obs", {"n": 1})
        assert await client.call("get_action") == [1]
        await client.heartbeat()
        assert (await client.health())["state"] == "ready"
        await client.settle()
        with pytest.raises(PolicyServerError, match="no method 'missing'"):
            await client.call("missing")
        await client.close()
        await client.close()
        with pytest.raises(ServerConnectionError, match="the client is closed"):
            await client.reset()
        async with AsyncClient(shared.url, pipelined=True, config=HASTE) as another:
            await another.reset()
            for n in range(20):
                await another.update_obs({"n": n})
            assert await another.get_action() == list(range(20))

    asyncio.run(scenario())


def test_tasks_that_share_a_client_take_turns(shared: RunningServer) -> None:
    async def scenario() -> None:
        async with AsyncClient(shared.url, config=HASTE) as client:
            await client.reset()
            answers = await asyncio.gather(*(client.call("echo", seen(n, n=n)) for n in range(20)))
            assert [answer["n"] for answer in answers] == list(range(20))
            assert all(np.array_equal(answer["vision"]["cam_head"]["color"], picture(n))
                       for n, answer in enumerate(answers))  # fmt: skip

    asyncio.run(scenario())


def test_a_cancelled_request_never_leaves_a_mixed_up_client(shared: RunningServer, fifo: Path) -> None:
    """The trial is over as after a timeout; a task that only waited for its turn changes nothing."""

    async def scenario() -> None:
        async with AsyncClient(shared.url, config=HASTE) as client:
            await client.reset()
            running = asyncio.ensure_future(client.update_obs(seen(1, fifo=str(fifo))))
            pipe = await asyncio.to_thread(fifo.open, "w")  # the model is at work now
            waiting = asyncio.ensure_future(client.call("echo", 1))
            await asyncio.sleep(0)
            waiting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await waiting
            running.cancel()
            with pytest.raises(asyncio.CancelledError):
                await running
            pipe.close()
            with pytest.raises(ClientError):
                await client.update_obs(seen(2, n=2))
        async with AsyncClient(shared.url, config=HASTE) as another:
            await another.reset()
            await another.update_obs(seen(3, n=3))
            assert await another.call("sums") == [zlib.crc32(picture(3))]

    asyncio.run(scenario())


# -- other ways to use a client ----------------------------------------------------------------------------------------


def test_threads_that_share_a_client_take_turns(shared: RunningServer) -> None:
    with Client(shared.url, config=HASTE) as client, ThreadPoolExecutor(4) as pool:
        client.reset()
        answers = list(pool.map(lambda n: client.call("echo", seen(n, n=n)), range(40)))
        for n, answer in enumerate(answers):
            assert answer["n"] == n
            assert np.array_equal(answer["vision"]["cam_head"]["color"], picture(n))


def test_long_lists_and_texts_travel_unpacked(shared: RunningServer) -> None:
    """Where they would not fit into the header of a packed payload; the arrays beside them come along."""
    value = {"list": list(range(1000)), "text": "é" * 300_000, "picture": picture(9)}
    for wishes in ({}, {"shared_memory": False}):
        with Client(shared.url, config=HASTE, **wishes) as client:
            got = client.call("echo", value)
            assert (got["list"], got["text"]) == (value["list"], value["text"])
            assert np.array_equal(got["picture"], picture(9))
            client.reset()
            client.update_obs(seen(10, n=value["text"]))
            assert client.call("sums") == [zlib.crc32(picture(10))]
            assert client.get_action() == [value["text"]]


def test_a_server_that_ends_says_so(subject: Path, serve: Callable[..., RunningServer]) -> None:
    server = serve(subject)
    with Client(server.url, pipelined=True) as client:
        client.reset()
        client.update_obs({"n": 1})
        os.kill(*workers(server), signal.SIGKILL)
        wait_until(lambda: any("error: " in line for line in server.log), "the server has ended")
        with pytest.raises(ServerFailedError, match="ended by signal SIGKILL"):
            client.get_action()


def test_a_client_that_leaves_at_once_costs_others_nothing(shared: RunningServer) -> None:
    """It is gone before the worker has opened the memory that it shares; the next one shares all the same."""
    shared.log.clear()
    for _ in range(20):
        Client(shared.url, config=HASTE).close()
    with Client(shared.url, config=HASTE) as client:
        assert spec.Capability.SHARED_MEMORY in client.capabilities
        client.reset()
        client.update_obs({"n": 1, "image": np.zeros((200, 200, 3), np.uint8)})
    assert not [line for line in shared.log if "share memory" in line]
