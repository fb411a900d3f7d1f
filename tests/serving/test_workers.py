from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed

from tests.support.outside.raw import BINARY, CLOSE, Raw, page
from tests.support.peer import Peer, greeted, wait_until
from xpl import Client
from xpl import _spec as spec
from xpl.client import PolicyServerError, ServerConnectionError, ServerFailedError
from xpl.wire import codec
from xpl_cli.basics.errors import ExitCode
from xpl_cli.serving.launch import RunningServer, ServerStartError, running_server

# Answers with the process and all that it was shown in the episode.
SUBJECT = """
    import os


    class Model:
        def __init__(self, config):
            self.seen = []

        def update_obs(self, obs):
            self.seen.append(obs.get("n"))
            if obs.get("fifo"):
                with open(obs["fifo"]) as pipe:
                    pipe.read()

        def get_action(self):
            return {"pid": os.getpid(), "seen": self.seen}

        def reset(self):
            self.seen = []
"""

# One model for all clients. An action's numbers are a running sum over the episode of what the environment was shown,
# the size of the batch it was made in, and the environment's own random number.
SHARED = """
    import numpy as np
    from xpl import Policy


    class Model(Policy):
        def load(self, config):
            self.sums = {}

        def encode(self, obs, env):
            self.sums[env] = self.sums.get(env, 0.0) + obs["n"]
            if obs.get("fail"):
                raise ValueError("the gripper is unhappy")
            return obs

        def predict(self, inputs, envs):
            for obs in inputs:
                if obs.get("fifo"):
                    with open(obs["fifo"]) as pipe:
                        pipe.read()
            chunks = np.zeros((len(envs), 2, 8))
            for chunk, env in zip(chunks, envs):
                chunk[:, 0] = self.sums[env]
                chunk[:, 1] = len(envs)
                chunk[:, 2] = self.rng(env).random()
            return chunks

        def reset_env(self, env):
            self.sums.pop(env, None)
"""
SHARING: dict[str, Any] = {"temporal": {"kind": "chunk", "chunk": 2}, "serving": {"shared": True}}
HASTE: dict[str, Any] = {"connect_retry_delay_s": 0.02, "max_connect_attempts": 0}
ONCE: dict[str, Any] = {"max_connect_attempts": 1}


@pytest.fixture(scope="module")
def subject(write_adapter: Callable[..., Path]) -> Path:
    """Return the folder of the adapter that is alone with its client."""
    return write_adapter(SUBJECT)


@pytest.fixture(scope="module")
def pair(subject: Path) -> Iterator[RunningServer]:
    with running_server(subject, options=["--workers", "2"]) as server:
        yield server


@pytest.fixture(scope="module")
def sharing(write_adapter: Callable[..., Path]) -> Iterator[RunningServer]:
    """Serve one model that all clients share; the place of a client that was cut off is soon free."""
    with running_server(write_adapter(SHARED, **SHARING), {"close_timeout_s": 0.2}) as server:
        yield server


@pytest.fixture
def free(pair: RunningServer, sharing: RunningServer) -> None:
    """Wait until the clients of the test before are gone."""
    for server in (pair, sharing):
        wait_until(lambda server=server: '"slots_in_use": 0' in page(server.url, "/healthz")[1], "all slots are free")


def actions(peer: Peer, n: int, step: int = 0) -> Any:
    return peer.ask("infer", {"observation": {"n": n}}, step=step).payload["actions"]


def goodbye(*peers: Peer) -> None:
    for peer in peers:
        with contextlib.suppress(ConnectionClosed):
            peer.send("close")
        peer.close()


# -- several copies of the model ---------------------------------------------------------------------------------------


@pytest.mark.usefixtures("free")
def test_each_client_has_a_worker_of_its_own(pair: RunningServer) -> None:
    """Their steps interleave and their states stay apart; a third one is busy until one of them leaves."""
    with Client(pair.url) as first, Client(pair.url) as second:
        for client in (first, second):
            client.reset()
        for n in range(3):
            one, two = first.infer({"n": n}), second.infer({"n": 10 + n})
        assert (one["seen"], two["seen"]) == ([0, 1, 2], [10, 11, 12])
        assert one["pid"] != two["pid"]
        with pytest.raises(ServerConnectionError, match="in use by another client"):
            Client(pair.url, config=ONCE)
        served: list[Any] = []

        def third() -> None:
            with Client(pair.url, config=HASTE) as client:
                client.reset()
                served.append(client.infer({"n": 20}))

        waiting = threading.Thread(target=third)
        waiting.start()
        second.close()
        waiting.join()
        assert served == [{"pid": two["pid"], "seen": [20]}]
        assert first.infer({"n": 3})["seen"] == [0, 1, 2, 3]


@pytest.mark.usefixtures("free")
def test_one_that_thinks_does_not_hold_up_the_other(pair: RunningServer, fifo: Path) -> None:
    """Both are at work at the same time."""
    with Client(pair.url) as slow, Client(pair.url) as quick:
        slow.reset()
        thread = threading.Thread(target=slow.infer, args=({"fifo": str(fifo)},))
        thread.start()
        with fifo.open("w"):
            quick.reset()
            assert quick.infer({"n": 1})["seen"] == [1]
        thread.join()


def test_a_worker_that_dies_ends_the_trial_of_its_client_only(
    subject: Path, serve: Callable[..., RunningServer], fifo: Path
) -> None:
    """A request under way gets the reason at once; the other client goes on; with the last worker the server ends."""
    server = serve(subject, options=["--workers", "2"])
    lucky, unlucky = Client(server.url), Client(server.url)
    for client in (lucky, unlucky):
        client.reset()
    pid = unlucky.infer({"n": 1})["pid"]
    with ThreadPoolExecutor() as pool:
        request = pool.submit(unlucky.infer, {"fifo": str(fifo)})
        with fifo.open("w"):
            os.kill(pid, signal.SIGKILL)
            with pytest.raises(PolicyServerError, match="ended by signal SIGKILL") as failure:
                request.result()
    assert failure.value.details == {"reason": "worker_died"}
    wait_until(lambda: any("1 of the workers continue" in line for line in server.log), "it is logged")
    with pytest.raises(ServerFailedError, match="the worker was ended by signal SIGKILL"):
        unlucky.infer({"n": 2})
    for n in range(3):
        seen = lucky.infer({"n": n})["seen"]
    assert seen == [0, 1, 2]
    with pytest.raises(ServerConnectionError, match="in use"):  # one place is left, and taken
        Client(server.url, config=ONCE)
    os.kill(lucky.infer({"n": 3})["pid"], signal.SIGKILL)
    wait_until(lambda: any(line.startswith("error: Subject: the worker") for line in server.log), "it is logged")
    with pytest.raises(ServerFailedError, match="the worker was ended by signal SIGKILL"):
        lucky.infer({"n": 4})
    wait_until(lambda: server.exit_code == ExitCode.NOT_RUN, "the server has ended")


# -- one model for several clients -------------------------------------------------------------------------------------


def told(chunk: Any) -> tuple[float, float, float]:
    """Return what the shared adapter put into its actions: running sum, batch size, random number."""
    total, batch, random = chunk[0]["arm_joint_state"][:3]
    return float(total), float(batch), float(random)


@pytest.mark.usefixtures("free")
def test_clients_of_a_shared_model_are_served_as_if_each_were_alone(sharing: RunningServer) -> None:
    """With states and random numbers of their own, whatever runs beside them."""

    def episode(number: int) -> list[tuple[float, float]]:
        with Client(sharing.url) as client:
            client.reset()
            told_all = [told(client.infer({"n": number * 100 + step})) for step in range(20)]
            return [(total, random) for total, _, random in told_all]

    alone = [episode(number) for number in range(4)]
    wait_until(lambda: '"slots_in_use": 0' in page(sharing.url, "/healthz")[1], "they have left")
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(episode, range(4)))
    for number, (one, other) in enumerate(zip(alone, together, strict=True)):
        sums = np.cumsum([number * 100 + step for step in range(20)])
        assert [total for total, _ in one] == [total for total, _ in other] == sums.tolist()
    assert len({pair for one in together for pair in one}) == 80


@pytest.mark.usefixtures("free")
def test_those_that_ask_at_once_are_one_batch(sharing: RunningServer, fifo: Path) -> None:
    """While the model thinks for one, the others gather; a failure belongs to the client that caused it."""
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(Client(sharing.url)) for _ in range(5)]
        for client in clients:
            client.reset()
        pool = stack.enter_context(ThreadPoolExecutor(5))

        def gathered(first: Any, *others: Any) -> list[Any]:
            thinking = pool.submit(clients[0].infer, {**first, "fifo": str(fifo)})
            with fifo.open("w"):
                asked = [pool.submit(client.infer, obs) for client, obs in zip(clients[1:], others, strict=False)]
                waiting = f'"waiting": {len(others)}'
                wait_until(lambda: waiting in page(sharing.url, "/healthz")[1], "all wait")
            return [thinking, *asked]

        answers = [told(one.result())[:2] for one in gathered(*({"n": n} for n in range(1, 6)))]
        assert answers == [(1, 1), (2, 4), (3, 4), (4, 4), (5, 4)]
        first, bad, good = gathered({"n": 1}, {"n": 2, "fail": True}, {"n": 3})
        assert (told(first.result())[0], told(good.result())[0]) == (2, 6)
        with pytest.raises(PolicyServerError, match="the gripper is unhappy"):
            bad.result()
        assert told(clients[2].infer({"n": 4}))[0] == 10


@pytest.mark.usefixtures("free")
def test_batches_of_several_clients_stay_apart(sharing: RunningServer) -> None:
    """Each has environments 0, 1, ... of its own, and answers in its own order."""
    with Client(sharing.url) as one, Client(sharing.url) as other:
        for client, base in ((one, 10), (other, 20)):
            client.reset()
            client.update_obs_batch([{"n": base + env, "env_idx": env} for env in (2, 0)])
        assert [told(chunk)[0] for chunk in one.get_action_batch()] == [12, 10]
        assert [told(chunk)[0] for chunk in other.get_action_batch([0, 2])] == [20, 22]
        other.reset()
        assert [told(chunk)[0] for chunk in one.get_action_batch([0])] == [10]
        with pytest.raises(PolicyServerError, match="no observation since the last reset"):
            other.get_action_batch([0])


@pytest.mark.usefixtures("free")
def test_a_client_that_leaves_or_resets_disturbs_nobody(sharing: RunningServer) -> None:
    """In order or by a cut; who takes its place begins anew without a reset of his own."""
    with Client(sharing.url) as stays:
        stays.reset()
        stays.infer({"n": 1})
        for leave in (Peer.cut, goodbye):
            other = greeted(sharing.url)
            actions(other, 5)
            other.ask("reset")
            actions(other, 6)
            leave(other)
            if leave is Peer.cut:
                other.close()
        before = told(stays.infer({"n": 1}))
        assert before[0] == 2
        wait_until(lambda: '"slots_in_use": 1' in page(sharing.url, "/healthz")[1], "their slots are free")
        for _ in range(spec.LIMITS["clients"]):  # more than there are places left: used ones are used again
            newcomer = greeted(sharing.url)
            assert told(actions(newcomer, 7))[0] == 7
            goodbye(newcomer)
        assert told(stays.infer({"n": 1}))[0] == 3


@pytest.mark.parametrize(
    ("model", "problem"),
    [
        ("class Model:\n    def __init__(self, config): pass", "has no .*reset_envs: derive it from xpl.Policy"),
        (SHARED + "\n        def prepare_case(self, case): pass", "prepare_case cannot distinguish clients"),
    ],
)
def test_a_model_that_cannot_be_shared_is_refused(write_adapter: Callable[..., Path], model: str, problem: str) -> None:
    """Before it is loaded, with what is missing."""
    with pytest.raises(ServerStartError, match=problem) as refusal, running_server(write_adapter(model, **SHARING)):
        pass
    assert refusal.value.code == ExitCode.NOT_RUN


# -- who has which place -----------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("free")
def test_a_new_client_on_a_used_place_finds_nothing_of_the_one_before(pair: RunningServer) -> None:
    for n in range(4):  # twice as many as there are workers
        peer = greeted(pair.url)
        assert actions(peer, n)["seen"] == [n]
        goodbye(peer)


@pytest.mark.usefixtures("free")
def test_each_tenancy_has_its_own_instance(pair: RunningServer) -> None:
    """A client that finds another one knows that its state is gone; one that comes back finds the same."""
    first, second = greeted(pair.url, session="a"), greeted(pair.url)
    identities = [peer.ask("hello").payload["server_instance_id"] for peer in (first, first, second)]
    assert identities[0] == identities[1] != identities[2]
    first.cut()
    back = greeted(pair.url, first.evaluation_id, session="a")
    assert back.ask("hello").payload["server_instance_id"] == identities[0]
    goodbye(back)
    stranger = greeted(pair.url, first.evaluation_id, session="b")
    assert stranger.ask("hello").payload["server_instance_id"] not in identities
    goodbye(stranger, second)
    first.close()


@pytest.mark.usefixtures("free")
def test_a_client_takes_its_place_back_while_its_lost_connection_seems_alive(pair: RunningServer) -> None:
    """By its secret; the old connection is closed with the reason, and cannot be used any more."""
    other = greeted(pair.url)
    half_open = greeted(pair.url, session="secret")
    half_open.ask("reset")
    actions(half_open, 1)
    back = greeted(pair.url, half_open.evaluation_id, session="secret")
    assert actions(back, 2)["seen"] == [1, 2]
    with pytest.raises(ConnectionClosed) as closed:
        half_open.receive()
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == spec.CLOSE_CODES["replaced"]
    for session in (None, "guess"):
        thief = Peer(pair.url, half_open.evaluation_id)
        payload = {} if session is None else {"capabilities": {"session": session}}
        assert thief.ask("hello", payload).payload["details"] == {"reason": "busy"}
        thief.close()
    assert actions(back, 3)["seen"] == [1, 2, 3]
    goodbye(other, back)
    half_open.close()


@pytest.mark.usefixtures("free")
@pytest.mark.parametrize("leave", ["replaced", "goodbye"])
def test_a_connection_that_is_closing_takes_no_place(pair: RunningServer, leave: str) -> None:
    """What it says after its last word is not carried out."""
    raw = Raw(pair.url)
    payload = {"capabilities": {"session": "secret"}}
    assert raw.ask(codec.encode(codec.Frame("hello", "e", payload))).message_type == "hello_ack"
    others = [greeted(pair.url, "e", session="secret")] if leave == "replaced" else []
    if leave == "goodbye":
        raw.send(BINARY, codec.encode(codec.Frame("close", "e")))
    assert raw.closed()[0] == {"replaced": spec.CLOSE_CODES["replaced"], "goodbye": 1000}[leave]
    for kind in ("hello", "reset", "infer"):
        raw.send(BINARY, codec.encode(codec.Frame(kind, "e", {"observation": {"n": 1}})))
    raw.send(CLOSE, (1000).to_bytes(2, "big"))
    wait_until(lambda: f'"connections": {len(others)}' in page(pair.url, "/healthz")[1], "it is gone")
    assert f'"slots_in_use": {len(others)}' in page(pair.url, "/healthz")[1]
    assert [actions(other, 1)["seen"] for other in others] in ([], [[1]])
    goodbye(*others)
    raw.close()


@pytest.mark.usefixtures("free")
@pytest.mark.parametrize("name", ["pair", "sharing"])
def test_an_episode_does_not_go_on_where_it_did_not_begin(request: pytest.FixtureRequest, name: str) -> None:
    """A client that is past its first step and was never reset here has its state elsewhere."""
    peer = greeted(request.getfixturevalue(name).url)
    for kind, payload in (
        ("infer", {"observation": {"n": 1}}),
        ("call", {"func_name": "update_obs", "obs": {"n": 1}}),
        ("call", {"func_name": "get_action"}),
    ):
        answer = peer.ask(kind, payload, step=7)
        assert (answer.message_type, answer.payload["details"]) == ("error", {"reason": "no_episode"})
        assert "this server has seen no reset of this client" in answer.payload["message"]
    assert peer.ask("reset", step=7).message_type == "reset_result"
    assert peer.ask("infer", {"observation": {"n": 1}}, step=8).message_type == "infer_result"
    goodbye(peer)
