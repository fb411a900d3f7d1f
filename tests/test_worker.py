"""The worker as a process of its own, spoken to over its private descriptor without a front end."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.peer import MARK, processes, wait_until
from xpl import link, worker
from xpl_cli.serving.worker_process import _BOOTSTRAP

SDK = str(Path(worker.__file__).parent)

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
    """A worker's process and our end of its link."""

    def __init__(self, python: str, cwd: Path, mark: str) -> None:
        self.channel, theirs = socket.socketpair()
        with theirs:
            self.process = subprocess.Popen(
                [python, "-c", _BOOTSTRAP, SDK, str(theirs.fileno())],
                pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                cwd=cwd, env={**os.environ, MARK: mark}, start_new_session=True,
            )  # fmt: skip

    def ask(self, **request: Any) -> Any:
        """Send a request and return the answer."""
        for piece in link.encode(request):
            self.channel.sendall(piece)
        return worker.receive(self.channel)

    def load(self, folder: Path, **manifest: Any) -> Any:
        """Load an adapter."""
        return self.ask(op="load", policy_dir=str(folder), config={"b": 1, "a": None}, manifest=manifest)

    def call(self, method: str, *args: Any) -> Any:
        """Call a method and return its result."""
        answer = self.ask(op="call", method=method, args=list(args))
        assert "error" not in answer, answer["error"]["traceback"]
        return answer["ok"]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Process]]:
    """Return a function that starts a worker; its end is certain."""
    mark = uuid.uuid4().hex
    started: list[Process] = []

    def run(python: str = sys.executable) -> Process:
        started.append(Process(python, tmp_path, mark))
        return started[-1]

    yield run
    for one in started:
        one.channel.close()
        one.process.wait(20)
        assert one.process.stdout is not None
        one.process.stdout.close()
    wait_until(lambda: not processes(mark), "all workers are gone")


@pytest.fixture(scope="module")
def echo(write_adapter: Callable[..., Path]) -> Path:
    """Return an adapter with a second module; its __init__.py must not run."""
    folder = write_adapter(ECHO)
    (folder / "sibling.py").write_text("NAME = 'sibling'\n", encoding="utf-8")
    (folder / "__init__.py").write_text("raise RuntimeError('the package itself was imported')\n", encoding="utf-8")
    return folder


def test_loading_tells_the_methods_that_may_be_called(start: Callable[..., Process], echo: Path) -> None:
    """Contract and declared ones that exist; a private name is none, declared or not."""
    answer = start().load(echo, methods=["about", "missing", "__init__", "config"])
    assert answer == {"ok": {"class": "Model", "methods": ["about", "get_action", "update_obs"]}}


def test_an_adapter_sees_its_own_folder_and_nothing_of_the_tool(start: Callable[..., Process], echo: Path) -> None:
    """Relative imports work; no folder was put on the path, least of all that of the tool."""
    process = start()
    process.load(echo, methods=["about"])
    about = process.call("about")
    assert about["name"] == "sibling"
    assert about["keys"] == ["a", "b"]  # a plain class gets the configuration alone
    assert about["sigint"] is True
    assert "" not in about["path"]
    assert SDK not in about["path"]
    assert str(echo) not in about["path"]


def test_observations_arrive_read_only_and_maps_are_the_adapters_own(start: Callable[..., Process], echo: Path) -> None:
    """Writing into an array is an error, not a change that others see."""
    process = start()
    process.load(echo, methods=["frozen", "changed"])
    answer = process.ask(op="call", method="frozen", args=[{"array": np.zeros(3)}])
    assert answer["error"]["type"] == "ValueError"
    assert "read-only" in answer["error"]["message"]
    assert process.call("changed", {"a": 1}) == {"a": 1, "new": 1}


def test_an_adapter_inside_a_checkout_of_the_ecosystem_imports_it(
    start: Callable[..., Process], tmp_path: Path
) -> None:
    """As the ecosystem's own server would let it."""
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
    process = start()
    assert process.load(folder)["ok"]["methods"] == ["infer"]
    assert process.ask(op="infer", observation={}) == {"ok": "template"}


def test_a_failure_is_described_without_our_own_frames(start: Callable[..., Process], write_adapter: Any) -> None:
    """Type, message, traceback; the next request is answered."""
    folder = write_adapter("""
        class Model:
            def __init__(self, config): pass
            def get_action(self): raise KeyError("state")
            def reset(self): raise SystemExit
    """)
    process = start()
    process.load(folder)
    error = process.ask(op="call", method="get_action", args=[])["error"]
    assert (error["type"], error["message"]) == ("KeyError", "'state'")
    assert "get_action" in error["traceback"]
    assert "in handle" not in error["traceback"]
    assert process.ask(op="call", method="reset", args=[])["error"]["message"] == "the adapter called sys.exit(None)"
    assert process.ask(op="call", method="dance", args=[])["error"]["type"] == "UnknownMethodError"


@pytest.mark.parametrize("noise", [b"\xff\xff\xff\xff", b"\x02\0\0\0[]"], ids=["length", "header"])
def test_a_link_out_of_step_ends_the_worker(start: Callable[..., Process], noise: bytes) -> None:
    """It cannot be mended, and a silent worker would be waited for."""
    process = start()
    process.channel.sendall(noise)
    process.process.wait(20)
    assert process.process.stdout is not None
    assert b"out of step" in process.process.stdout.read()


def test_a_worker_ends_with_the_front_end_even_while_it_computes(
    start: Callable[..., Process], write_adapter: Any, tmp_path: Path
) -> None:
    """The link's end is enough."""
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    folder = write_adapter("""
        class Model:
            def __init__(self, config): pass
            def infer(self, observation): open(observation["fifo"]).read()
    """)
    process = start()
    process.load(folder)
    for piece in link.encode({"op": "infer", "observation": {"fifo": str(fifo)}}):
        process.channel.sendall(piece)
    with fifo.open("w"):
        process.channel.close()
        process.process.wait(20)


def test_the_worker_runs_in_the_oldest_supported_python(
    start: Callable[..., Process], write_adapter: Any, old_python: str
) -> None:
    """With numpy alone installed there, and every module that a worker imports."""
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
    actions = process.ask(op="infer", observation=value)["ok"]
    assert actions[0]["ee_joint_state"].tolist() == pytest.approx([0.9])
