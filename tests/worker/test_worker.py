"""The worker as a process of its own, spoken to over its private descriptor without a front end."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.peer import DEADLINE_S, MARK, processes, wait_until
from xpl import _spec as spec
from xpl.process import link
from xpl.process.link import Channel
from xpl.wire import packed
from xpl.wire.segment import Arena, Segment
from xpl.worker import main
from xpl.worker.main import WorkerRequest
from xpl_cli.serving.workers.process import _BOOTSTRAP

SDK = str(Path(main.__file__).parents[1])

ECHO = """
    import signal, sys
    from .sibling import NAME

    class Model:
        def __init__(self, config):
            self.config = config

        def update_obs(self, obs):
            self.obs = obs

        def get_action(self):
            return self.obs

        def about(self):
            ignored = signal.getsignal(signal.SIGINT) == signal.SIG_IGN
            return {"name": NAME, "keys": sorted(self.config), "path": sys.path, "sigint": ignored}

        def frozen(self, obs):
            obs["array"][0] = 1

        def changed(self, obs):
            obs["new"] = 1
            return obs
"""


class Process:
    def __init__(self, python: str, cwd: Path, mark: str) -> None:
        self.channel, theirs = socket.socketpair()
        with theirs:
            self.process = subprocess.Popen(
                [python, "-c", _BOOTSTRAP, SDK, str(theirs.fileno())],
                pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                cwd=cwd, env={**os.environ, MARK: mark}, start_new_session=True,
            )  # fmt: skip
        self._link = Channel(self.channel)

    def send(self, *buffers: bytes, **head: Any) -> None:
        self._link.send(head, buffers)

    def receive(self) -> tuple[Any, list[Any]]:
        answer = self._link.receive()
        assert answer is not None, "the worker has ended"
        head, buffers = link.decode(answer)
        return head, [packed.decode(buffer) for buffer in buffers]

    def ask(self, **head: Any) -> Any:
        self.send(**head)
        answer, buffers = self.receive()
        assert buffers == []
        return answer

    def load(self, folder: Path, **manifest: Any) -> Any:
        return self.ask(op="load", policy_dir=str(folder), config={"b": 1, "a": None}, manifest=manifest)

    def start(self, *requests: WorkerRequest) -> None:
        self.send(*(one.payload for one in requests), op="run", requests=[one[:4] for one in requests])

    def answers(self) -> list[dict[str, Any]]:
        head, results = self.receive()
        entries = iter(results)
        answers = [{"ok": next(entries)} if error is None else {"error": error} for error in head["answers"]]
        assert next(entries, None) is None
        return answers

    def run(self, *requests: WorkerRequest) -> list[dict[str, Any]]:
        self.start(*requests)
        return self.answers()

    def call(self, method: str, *obs: Any) -> Any:
        (answer,) = self.run(request(method, *obs))
        assert "error" not in answer, answer["error"]["traceback"]
        return answer["ok"].get("result")

    def fails(self, method: str, *obs: Any) -> Any:
        (answer,) = self.run(request(method, *obs))
        return answer["error"]


def request(method: str, *obs: Any, place: packed.Allocate | None = None, **fields: Any) -> WorkerRequest:
    """Return a request to call a method; `infer` takes its argument by another name."""
    payload = dict(zip(["observation" if method == "infer" else "obs"], obs, strict=False))
    return raw(method, payload, place=place, **fields)


def raw(
    method: str,
    payload: Any,
    *,
    place: packed.Allocate | None = None,
    client: int = 0,
    segment: int | None = None,
    optional: bool = False,
) -> WorkerRequest:
    return WorkerRequest(client, method, segment, optional, b"".join(packed.encode(payload, place)))


@contextlib.contextmanager
def starting(folder: Path) -> Iterator[Callable[..., Process]]:
    mark = uuid.uuid4().hex
    started: list[Process] = []

    def run(python: str = sys.executable) -> Process:
        started.append(Process(python, folder, mark))
        return started[-1]

    yield run
    for one in started:
        one.channel.close()
        one.process.wait(DEADLINE_S)
        assert one.process.stdout is not None
        one.process.stdout.close()
    wait_until(lambda: not processes(mark), "all workers are gone")


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Process]]:
    """Return a function that starts a worker; its end is certain."""
    with starting(tmp_path) as run:
        yield run


@pytest.fixture(scope="module")
def worker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Process]:
    """Return one worker for the adapters of all tests that do not end it: each takes the place of the one before."""
    with starting(tmp_path_factory.mktemp("cwd")) as run:
        yield run()


@pytest.fixture(scope="module")
def echo(write_adapter: Callable[..., Path]) -> Path:
    folder = write_adapter(ECHO)
    (folder / "sibling.py").write_text("NAME = 'sibling'\n", encoding="utf-8")
    (folder / "__init__.py").write_text("raise RuntimeError('the package itself was imported')\n", encoding="utf-8")
    return folder


def test_loading_tells_the_methods_that_may_be_called(worker: Process, echo: Path) -> None:
    """Contract and declared ones that exist; a private name is none, declared or not."""
    answer = worker.load(echo, methods=["about", "missing", "__init__", "config"])
    assert answer == {"ok": {"class": "Model", "methods": ["about", "get_action", "update_obs"], "shared": False}}


def test_an_adapter_sees_its_own_folder_and_nothing_of_the_tool(worker: Process, echo: Path) -> None:
    worker.load(echo, methods=["about"])
    about = worker.call("about")
    assert about["name"] == "sibling"
    assert about["keys"] == ["a", "b"]  # a plain class gets the configuration alone
    assert about["sigint"] is True
    assert "" not in about["path"]
    assert SDK not in about["path"]
    assert str(echo) not in about["path"]


def test_observations_arrive_read_only_and_maps_are_the_adapters_own(worker: Process, echo: Path) -> None:
    worker.load(echo, methods=["frozen", "changed"])
    error = worker.fails("frozen", {"array": np.zeros(3)})
    assert error["type"] == "ValueError"
    assert "read-only" in error["message"]
    assert worker.call("changed", {"a": 1}) == {"a": 1, "new": 1}


def test_an_adapter_inside_a_checkout_of_the_ecosystem_imports_it(worker: Process, tmp_path: Path) -> None:
    root = tmp_path / "Ecosystem"
    folder = root / "policy" / "Subject"
    folder.mkdir(parents=True)
    (root / "model_template.py").write_text("class ModelTemplate: kind = 'template'\n", encoding="utf-8")
    (root / "__init__.py").touch()
    (folder / "model.py").write_text(
        "from Ecosystem.model_template import ModelTemplate\n"
        "class Model(ModelTemplate):\n"
        "    def __init__(self, config): pass\n"
        "    def infer(self, observation): return self.kind\n",
        encoding="utf-8",
    )
    assert worker.load(folder)["ok"]["methods"] == ["infer"]
    assert worker.run(request("infer", {})) == [{"ok": {"actions": "template"}}]


# -- requests ----------------------------------------------------------------------------------------------------------


def test_requests_of_one_message_run_in_their_order(worker: Process, write_adapter: Any) -> None:
    folder = write_adapter("""
        class Model:
            def __init__(self, config): self.seen = []
            def update_obs(self, obs): self.seen.append(obs["n"])
            def update_obs_batch(self, obs_list): self.seen.extend(obs["n"] for obs in obs_list)
            def get_action(self): return list(self.seen)
            def get_action_batch(self, env_idx_list=None): return env_idx_list
            def reset(self): self.seen.clear()
    """)
    worker.load(folder)
    answers = worker.run(
        request("update_obs", {"n": 1}),
        request("update_obs", {"no n": 2}),
        request("update_obs_batch", [{"n": 3}, {"n": 4}]),
        request("get_action"),
        request("get_action", {"n": 5}),
        request("infer", {"n": 6}),
        request("reset"),
        request("get_action"),
        request("get_action_batch"),
        request("get_action_batch", []),
        request("get_action_batch", [3]),
    )
    assert answers[1].pop("error")["type"] == "KeyError"
    assert [answer.get("ok") for answer in answers] == [
        {}, None, {}, {"result": [1, 3, 4]}, {"result": [1, 3, 4, 5]}, {"actions": [1, 3, 4, 5, 6]},
        {}, {"result": []}, {}, {"result": []}, {"result": [3]},
    ]  # fmt: skip


def test_the_answer_holds_the_entries_of_the_wire(worker: Process, write_adapter: Any) -> None:
    """A result map that already has actions passes through, and nothing else does."""
    folder = write_adapter("""
        class Model:
            def __init__(self, config): pass
            def infer(self, observation): return observation["answer"]
            def declared(self, answer): return answer
    """)
    worker.load(folder, methods=["declared"])
    for answer, entries in [
        ({"actions": [1], "confidence": 0.5}, {"actions": [1], "confidence": 0.5}),
        ({"action": [1]}, {"actions": {"action": [1]}}),
        (None, {"actions": None}),
    ]:
        assert worker.run(request("infer", {"answer": answer})) == [{"ok": entries}]
    assert worker.run(request("declared", {"actions": 1})) == [{"ok": {"result": {"actions": 1}}}]


def test_a_failure_is_described_without_our_own_frames(worker: Process, write_adapter: Any) -> None:
    folder = write_adapter("""
        class Model:
            def __init__(self, config): pass
            def get_action(self): raise KeyError("state")
            def reset(self): raise SystemExit
            def get_action_batch(self): raise RuntimeError
    """)
    worker.load(folder)
    error = worker.fails("get_action")
    assert (error["type"], error["message"]) == ("KeyError", "'state'")
    assert "in get_action" in error["traceback"]
    assert "worker.py" not in error["traceback"]
    assert "refused" not in error
    assert worker.fails("reset")["message"] == "the adapter called sys.exit(None)"
    assert worker.fails("get_action_batch")["message"] == "RuntimeError"


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        (request("dance"), "no method 'dance'; it has get_action, update_obs"),
        (request("config"), "no method 'config'"),
        (request("infer"), "needs a payload with an observation map"),
        (request("infer", [1]), "needs a payload with an observation map"),
        (request("update_obs"), "a map; got NoneType"),
        (request("update_obs", [1]), "a map; got list"),
        (raw("get_action", [1]), "must be a map, got list"),
        (request("get_action")._replace(payload=b"XPL1"), "begins with 16 bytes"),
        (raw("update_obs", {"obs": {"a": np.zeros(5000)}}, place=lambda _: (0, 4096)), "agreed on none"),
    ],
)
def test_a_request_that_is_wrong_is_refused(worker: Process, echo: Path, asked: WorkerRequest, says: str) -> None:
    """By a mark that the front end understands: the adapter was not asked."""
    worker.load(echo)
    (answer,) = worker.run(asked)
    assert answer["error"]["refused"] is True
    assert says in answer["error"]["message"]
    assert worker.run(request("update_obs", {"a": 1})) == [{"ok": {}}]


def test_a_result_that_cannot_travel_is_marked(worker: Process, write_adapter: Any) -> None:
    """It is neither the request's fault nor a failure of the call."""
    folder = write_adapter("""
        import numpy as np

        loop = []
        loop.append(loop)
        results = [object(), {1: {2}}, np.array(['2026'], 'M8[D]'), loop]

        class Model:
            def __init__(self, config): pass
            def infer(self, observation): return results[observation["result"]]
            def get_action(self): return 1
    """)
    worker.load(folder)
    for result in range(4):
        bad, good = worker.run(request("infer", {"result": result}), request("get_action"))
        assert bad["error"]["unserialisable"] is True
        assert "refused" not in bad["error"]
        assert good == {"ok": {"result": 1}}


def test_hooks_are_optional_and_get_the_payload(worker: Process, write_adapter: Any) -> None:
    folder = write_adapter("""
        class Model:
            def __init__(self, config): pass
            def prepare_case(self, case): return case
            def update_obs(self, obs): raise AssertionError
    """)
    worker.load(folder)
    assert worker.run(
        raw("prepare_case", {"action_case_id": "c", "obs": {}}, optional=True),
        raw("on_trial_end", {"trial_id": "t", "obs": {}}, optional=True),
    ) == [{"ok": {"result": {"action_case_id": "c", "obs": {}}}}, {"ok": {}}]
    assert worker.fails("on_trial_end")["refused"] is True


# -- arrays in shared memory -------------------------------------------------------------------------------------------


@pytest.fixture
def memory() -> Iterator[tuple[Segment, Arena]]:
    segment = Segment(1 << 22)
    arena = Arena(str(segment.path), segment.size)
    yield segment, arena
    arena.close()
    segment.close()


def states(arena: Arena) -> set[int]:
    start = spec.SHARED_MEMORY["states_at"]
    return set(arena._map[start : start + spec.SHARED_MEMORY["blocks"]])


def image(value: int) -> dict[str, Any]:
    return {"image": np.full(50_000, value, np.uint8)}


@pytest.mark.parametrize("shared", [False, True])
def test_a_request_that_fails_keeps_no_shared_memory(
    worker: Process, write_adapter: Any, memory: tuple[Segment, Arena], shared: bool
) -> None:
    segment, arena = memory
    folder = write_adapter("""
        import gc
        gc.disable()

        class Model:
            def __init__(self, config): pass
            def update_obs(self, obs): raise ValueError(obs["image"].sum())
            def update_obs_batch(self, obs_list): self.update_obs(obs_list[0])
            def get_action_batch(self, envs): pass
            def reset_envs(self, envs): pass
    """)
    worker.load(folder, serving={"shared": shared})
    worker.ask(op="map", segment=1, path=str(segment.path), size=segment.size)
    sends = [request("update_obs", image(1), place=arena.store, segment=1, client=client) for client in range(2)]
    assert [answer["error"]["type"] for answer in worker.run(*sends)] == ["ValueError"] * 2
    assert states(arena) == {spec.SHARED_MEMORY["free"]}


def test_a_segment_that_cannot_be_mapped_is_an_error(worker: Process, echo: Path, tmp_path: Path) -> None:
    answer = worker.ask(op="map", segment=1, path=str(tmp_path / "xpl-gone"), size=100)
    assert answer["error"]["type"] == "SegmentError"
    assert "ok" in worker.load(echo)


# -- a model for several clients ---------------------------------------------------------------------------------------

SHARED = """
    import numpy as np
    from xpl import Policy

    class Model(Policy):
        def encode(self, obs, env): return obs["n"]
        def predict(self, inputs, envs):
            rows = np.zeros((len(envs), 1, 8))
            rows[:, 0, 0], rows[:, 0, 1] = inputs, len(envs)
            return rows
"""


def test_a_shared_model_answers_clients_together(worker: Process, write_adapter: Any) -> None:
    """Each with its own answer or error; what is refused, and hooks that it does not have, are no observations."""
    config = {"env_cfg_type": "franka_single"}
    folder = str(write_adapter(SHARED))
    loaded = worker.ask(op="load", policy_dir=folder, config=config, manifest={"serving": {"shared": True}})
    assert loaded["ok"]["shared"] is True
    answers = worker.run(
        request("infer", {"n": 1}, client=0),
        raw("prepare_case", {"action_case_id": "c"}, client=1, optional=True),
        request("update_obs", [1], client=2),
        request("infer", {"n": 3}, client=3),
        request("infer", {"no n": 3}, client=4),
        request("dance", client=5),
        request("get_action", client=6),
        raw("on_trial_end", {}, client=7, optional=True),
        request("reset", client=8),
    )
    chunks = [answer["ok"]["actions"][0]["arm_joint_state"].tolist()[:2] for answer in (answers[0], answers[3])]
    assert chunks == [[1, 1], [3, 1]]  # one of the batch failed, so each was tried alone
    assert answers[1] == answers[7] == answers[8] == {"ok": {}}
    assert [answers[place]["error"].get("refused") for place in (2, 4, 5, 6)] == [True, None, True, None]
    assert [answers[place]["error"]["type"] for place in (4, 6)] == ["KeyError", "PolicyStateError"]
    together = worker.run(*(request("infer", {"n": client}, client=client) for client in range(3)))
    assert [answer["ok"]["actions"][0]["arm_joint_state"].tolist()[:2] for answer in together] == [
        [0, 3], [1, 3], [2, 3]
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("body", "methods", "says"),
    [
        ("update_obs_batch = get_action_batch = print", [], "has no reset_envs"),
        ("def reset_envs(self, envs): pass", [], "has no update_obs_batch, get_action_batch"),
        ("def prepare_case(self, case): pass", [], "prepare_case cannot distinguish clients"),
        ("def on_trial_end(self, case): pass", [], "on_trial_end cannot distinguish"),
        ("def about(self): pass", ["about"], "about cannot distinguish"),
    ],
)
def test_a_model_that_cannot_tell_its_clients_apart_is_not_shared(
    worker: Process, write_adapter: Any, body: str, methods: list[str], says: str
) -> None:
    base = "Policy" if "distinguish" in says else "object"
    folder = write_adapter(f"from xpl import Policy\nclass Model({base}):\n    {body}\n")
    answer = worker.load(folder, serving={"shared": True}, methods=methods)
    assert answer["error"]["type"] == "LoadError"
    assert says in answer["error"]["message"]


# -- the process -------------------------------------------------------------------------------------------------------


def test_a_signal_shows_where_the_worker_is(worker: Process, write_adapter: Any, tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    folder = write_adapter("""
        class Model:
            def __init__(self, config): pass
            def infer(self, observation):
                print("waits", flush=True)
                open(observation["fifo"]).read()
    """)
    worker.load(folder)
    worker.start(request("infer", {"fifo": str(fifo)}))
    assert worker.process.stdout is not None
    assert worker.process.stdout.readline() == b"waits\n"
    worker.process.send_signal(signal.SIGUSR1)
    shown = b""
    while b"in infer" not in shown:
        line = worker.process.stdout.readline()
        assert line, "the worker ended"
        shown += line
    assert b"most recent call first" in shown
    with fifo.open("w"):
        pass
    assert worker.answers() == [{"ok": {"actions": None}}]


@pytest.mark.parametrize("noise", [b"\xff" * 16, b"Traceback (most recent call last)"], ids=["bytes", "text"])
def test_a_link_out_of_step_ends_the_worker(start: Callable[..., Process], noise: bytes) -> None:
    process = start()
    process.channel.sendall(noise)
    process.process.wait(DEADLINE_S)
    assert process.process.stdout is not None
    assert b"out of step" in process.process.stdout.read()


def test_a_worker_ends_with_the_front_end_even_while_it_computes(
    start: Callable[..., Process], write_adapter: Any, tmp_path: Path
) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    folder = write_adapter("""
        class Model:
            def __init__(self, config): pass
            def infer(self, observation): open(observation["fifo"]).read()
    """)
    process = start()
    process.load(folder)
    process.start(request("infer", {"fifo": str(fifo)}))
    with fifo.open("w"):
        process.channel.close()
        process.process.wait(DEADLINE_S)


def test_the_worker_runs_in_the_oldest_supported_python(
    start: Callable[..., Process], write_adapter: Any, old_python: str
) -> None:
    folder = write_adapter("""
        import sys
        import numpy as np
        from xpl import Policy
        from xpl import action, checkpoint, embodiment, observation

        class Model(Policy):
            def encode(self, obs, env): return obs["n"]
            def predict(self, inputs, envs): return np.full((len(envs), 2, 8), sys.version_info[1] / 10)
    """)
    process = start(old_python)
    answer = process.ask(op="load", policy_dir=str(folder), config={"env_cfg_type": "franka_single"}, manifest={})
    assert "ok" in answer, answer["error"]["traceback"]
    value = {"structure": np.zeros(2, [("a", ">i2"), ("b", "<f4", (2,))]), "n": 1, "scalar": np.float32(1)}
    (answer,) = process.run(request("infer", value))
    assert answer["ok"]["actions"][0]["ee_joint_state"].tolist() == pytest.approx([0.9])
