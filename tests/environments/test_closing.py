"""However an evaluation ends, its environment is closed, once; and an environment can ask the operator."""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.adapters import drill
from tests.support.checkout import ROOT
from tests.support.peer import DEADLINE_S, wait_until
from xpl.simulator.process import EnvRaisedError
from xpl.simulator.terminal import TERMINAL, NoTerminalError
from xpl.simulator.worker_pool import EnvTimeouts
from xpl.vector import VectorEnv

CLIENT = """
    import os, signal, time
    from pathlib import Path
    import numpy as np

    HERE = Path(__file__).parent

    class Env:
        guarded = True

        def __init__(self, config):
            self.steps = 0

        def reset(self, seed=None, options=None):
            self.steps = 0
            if (HERE / "asks").exists():
                (HERE / "answer").write_text(input("is the scene ready? "))

        def get_obs_batch(self, env_idx_list=None, last_frame=False):
            return [{"env_idx": 0, "state": {"arm_joint_state": np.zeros(7), "ee_joint_state": np.ones(1)}}]

        def get_running_env_idx_list(self):
            return [0]

        def take_action_batch(self, actions, env_idx_list):
            self.steps += 1
            with open(HERE / "steps", "a") as file:
                file.write("s")
            do = actions[0].get("do") if isinstance(actions[0], dict) else None
            if do == "hang":
                signal.pause()
            if do == "sleep":
                time.sleep(0.3)
            if do == "raise":
                raise RuntimeError("jammed")
            return [{}]

        def results(self):
            return [{"env_idx": 0, "success": False, "score": 0.0, "steps": self.steps, "end_reason": "max_steps"}]

        def close(self):
            with open(HERE / "closed", "a") as file:
                file.write("c")


    def make(config):
        return Env(config)
"""


@pytest.fixture
def client(tmp_path: Path) -> Path:
    """Return the client file of an environment that notes that it is closed."""
    (tmp_path / "client.py").write_text(textwrap.dedent(CLIENT))
    return tmp_path / "client.py"


@pytest.fixture
def start(client: Path) -> Iterator[Callable[..., VectorEnv]]:
    """Return a function that starts it."""
    with contextlib.ExitStack() as stack:

        def made(**options: Any) -> VectorEnv:
            env = VectorEnv(client, {}, **options)
            stack.callback(env.close)
            return env

        yield made


def _closed(client: Path) -> str:
    file = client.parent / "closed"
    return file.read_text() if file.exists() else ""


def test_closing_closes_once(start: Callable[..., VectorEnv], client: Path) -> None:
    env = start()
    env.reset([0])
    env.close()
    env.close()
    assert _closed(client) == "c"


@pytest.mark.parametrize("do", ["hang", "raise"])
def test_an_environment_that_is_lost_is_closed_before(start: Callable[..., VectorEnv], client: Path, do: str) -> None:
    """In a step from which it does not come back another thread closes it."""
    env = start(limits=EnvTimeouts(step_s=0.3))
    env.reset([0])
    env.take_action_batch([{"do": do}], [0])
    assert _closed(client) == "c"


def test_an_interrupt_in_the_middle_of_a_step_closes_it(start: Callable[..., VectorEnv], client: Path) -> None:
    """The answer to the step is still on its way then."""
    env = start()
    env.reset([0])
    signal.signal(signal.SIGALRM, _interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.1)
    try:
        with pytest.raises(KeyboardInterrupt):
            env.take_action_batch([{"do": "sleep"}], [0])
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    env.close()
    assert _closed(client) == "c"


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("do", ["hang", "sleep"])
def test_sigterm_closes_it(start: Callable[..., VectorEnv], client: Path, do: str) -> None:
    env = start()
    env.reset([0])
    (pid,) = env.pids
    signal.signal(signal.SIGALRM, lambda *_: os.kill(pid, signal.SIGTERM))
    signal.setitimer(signal.ITIMER_REAL, 0.1)
    env.take_action_batch([{"do": do}], [0])
    wait_until(lambda: _closed(client), "it is closed")
    assert _closed(client) == "c"


def test_it_is_closed_when_its_leader_is_killed(client: Path) -> None:
    """Nobody is left to say so, and it is in the middle of a step."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[2]); from pathlib import Path; from xpl.vector import VectorEnv\n"
        "env = VectorEnv(Path(sys.argv[1]), {}); env.reset([0]); env.take_action_batch([{'do': 'hang'}], [0])"
    )
    leader = subprocess.Popen([sys.executable, "-c", code, str(client), str(ROOT)])
    wait_until((client.parent / "steps").exists, "a step")
    leader.kill()
    leader.wait()
    wait_until(lambda: _closed(client), "it is closed")


# -- asking a person ---------------------------------------------------------------------------------------------------


def test_an_environment_asks_at_the_leaders_terminal(
    start: Callable[..., VectorEnv], client: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From a process that has no terminal of its own."""
    ours, theirs = pty.openpty()
    monkeypatch.setenv(TERMINAL, os.ttyname(theirs))
    (client.parent / "asks").touch()
    os.write(ours, b"yes\n")
    start().reset([0])
    assert (client.parent / "answer").read_text() == "yes"
    os.close(ours)
    os.close(theirs)


def test_without_a_terminal_it_is_told_so(
    start: Callable[..., VectorEnv], client: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not by an end of file that nobody understands."""
    monkeypatch.delenv(TERMINAL, raising=False)
    (client.parent / "asks").touch()
    with pytest.raises(EnvRaisedError, match="no terminal") as failure:
        start().reset([0])
    assert failure.value.kind == NoTerminalError.__name__


SLOW = """
    import time

    _take = Env.take_action


    def _slowly(self, action):
        (HERE / "began").touch()
        time.sleep(0.05)
        return _take(self, action)


    def _close(self):
        with open(HERE / "closed", "a") as file:
            file.write("c")


    Env.take_action, Env.close = _slowly, _close
"""


# -- whole evaluations -------------------------------------------------------------------------------------------------


@pytest.mark.sampled(1)
@pytest.mark.parametrize("options", [[], ["--out", "run"]], ids=["look", "recorded"])
@pytest.mark.parametrize("ending", ["SIGINT", "SIGTERM", "SIGKILL", "policy"])
def test_every_ending_of_an_evaluation_closes_its_environment(tmp_path: Path, options: list[str], ending: str) -> None:
    """Ctrl-C, a supervisor's signal, what nobody can catch, and a policy that raises or whose process is killed."""
    env = drill.environment(tmp_path)
    policy = drill.adapter(tmp_path, **({"raises": [0]} if ending == "policy" and not options else {}))
    if ending == "policy":
        drill.mark(tmp_path, "policy-dies-0", 9)
    client = env / "client.py"
    client.write_text(client.read_text() + textwrap.dedent(SLOW))
    command = [sys.executable, "-m", "xpl_cli", "eval", str(policy), "--env", str(env), *options]
    command += ["--episodes", "1" if ending == "policy" else "200"]
    process = subprocess.Popen(
        command, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": str(ROOT)}, start_new_session=True,
    )  # fmt: skip
    try:
        wait_until((env / "began").exists, "an episode")
        if ending != "policy":
            process.send_signal(getattr(signal, ending))
        process.wait(DEADLINE_S)
        wait_until((env / "closed").exists, "it is closed")
    finally:
        process.kill()
        process.wait()
    assert (env / "closed").read_text() == "c"
