"""Environments in worker processes: equal to those in one process, lost one by one, gone with their parent."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import textwrap
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.checkout import ROOT
from tests.support.examples import examples
from tests.support.peer import MARK, processes, wait_until
from xpl.action import ActionError
from xpl.process.modules import load_module
from xpl.rollout import run_batch
from xpl.simulator.process import EnvLostError, EnvRaisedError
from xpl.simulator.worker_pool import EnvTimeouts
from xpl.vector import INFRASTRUCTURE, VectorEnv, shares
from xpl_cli.basics.content import content_folder

CLIENT = """
    import os, signal, subprocess, sys
    import numpy as np
    from xpl.action import ActionError

    class Env:
        '''Environments whose episode lasts as many steps as their seed says; an action may be a misfortune.'''

        guarded = True

        def __init__(self, config):
            self.count = config.get("num_envs") or 1
            self.options = {}
            self.closed = config.get("closed")
            print("made")
            if config.get("misfortune"):
                self.suffer(config["misfortune"])
            if config.get("child"):
                subprocess.Popen(["sleep", "600"])

        def suffer(self, what):
            if what == "die":
                os.kill(os.getpid(), signal.SIGKILL)
            if what == "exit":
                os._exit(3)
            if what == "hang":
                signal.pause()
            if what == "raise":
                raise RuntimeError("the gears are jammed")
            if what == "refuse":
                raise ActionError("no such action")
            if what == "value":
                raise ValueError("no such value")

        def reset(self, seed=None, options=None):
            self.seeds, self.steps = list(seed), [0] * self.count
            self.options.update(options or {})
            self.suffer(self.options.get("misfortune"))

        def get_obs(self):
            return self.get_obs_batch([0])[0]

        def get_obs_batch(self, env_idx_list=None):
            chosen = self.get_running_env_idx_list() if env_idx_list is None else env_idx_list
            return [
                {"env_idx": env, "state": {"x": np.array([self.seeds[env], self.steps[env]])}, "pid": os.getpid(),
                 "options": self.options, "variable": os.environ.get("XPL_TEST_WRAPPED")}
                for env in chosen
            ]

        def take_action(self, action):
            return self.take_action_batch([action], [0])[0]

        def take_action_batch(self, actions, env_idx_list):
            for env, action in zip(env_idx_list, actions):
                self.suffer(action.get("do"))
                self.steps[env] += 1
            return [{"env_idx": env, "step": self.steps[env]} for env in env_idx_list]

        def get_running_env_idx_list(self):
            return [env for env in range(self.count) if self.steps[env] < self.seeds[env]]

        def is_episode_end(self):
            return not self.get_running_env_idx_list()

        def results(self):
            return [
                {"env_idx": env, "seed": self.seeds[env], "steps": self.steps[env], "success": True, "score": 1.0,
                 "end_reason": None if self.steps[env] < self.seeds[env] else "success"}
                for env in range(self.count)
            ]

        def close(self):
            print("closed")
            if self.closed:
                open(f"{self.closed}/{os.getpid()}", "x").close()

    def make(config):
        return Env(config)
"""
ON = {"do": "go on"}


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("misfortunes") / "client.py"
    path.write_text(textwrap.dedent(CLIENT), encoding="utf-8")
    return path


@pytest.fixture
def start(client: Path) -> Iterator[Callable[..., VectorEnv]]:
    mark = uuid.uuid4().hex
    os.environ[MARK] = mark
    try:
        with contextlib.ExitStack() as stack:
            yield lambda config=(), **options: stack.enter_context(
                contextlib.closing(VectorEnv(client, dict(config), **options))
            )
        wait_until(lambda: not processes(mark), "all processes of the environment are gone")
    finally:
        del os.environ[MARK]


# -- equality ----------------------------------------------------------------------------------------------------------


def test_workers_play_what_one_process_plays_bit_by_bit() -> None:
    pytest.importorskip("mujoco")
    path = content_folder("envs") / "mujoco" / "client.py"
    config = {"task": "lift_cube", "embodiment": "arx_x5", "num_envs": 2, "cameras": [24, 32], "max_steps": 6}
    arms = ("left_arm_joint_state", "left_ee_joint_state", "right_arm_joint_state", "right_ee_joint_state")

    def play(env: Any) -> list[Any]:
        told: list[Any] = []
        for options in (None, {"setting": "randomized", "privileged": True}):
            env.reset(None if options else [7, 8], options)
            rng = np.random.default_rng(0)
            while not env.is_episode_end():
                running = env.get_running_env_idx_list()
                observations = env.get_obs_batch([*reversed(running)])
                drawn = [
                    [obs["state"][key] + rng.normal(0, 0.1, obs["state"][key].shape) for key in arms]
                    for obs in observations
                ]
                actions = [
                    {key: values.astype(np.float32) for key, values in zip(arms, each, strict=True)} for each in drawn
                ]
                if len(told) == 3:
                    actions[0][arms[0]][2] = np.nan
                told.append((running, observations, env.take_action_batch(actions, [*reversed(running)])))
            told.append(env.results())
        return told

    with contextlib.closing(VectorEnv(path, config, workers=2)) as apart:
        found = play(apart)
        assert apart.guarded
    with contextlib.closing(load_module(path).make(config)) as together:
        wanted = play(together)
    np.testing.assert_equal(found, wanted)
    assert wanted[-1][0]["seed"] == 9
    assert [len(entry[0]) for entry in wanted[:5]] == [2, 2, 2, 2, 1]


@given(st.integers(1, 40), st.integers(1, 40))
def test_every_environment_is_somebodys(total: int, workers: int) -> None:
    parts = shares(total, min(workers, total))
    assert [env for part in parts for env in part] == list(range(total))
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


class Recorder:
    def __init__(self) -> None:
        self.log: list[Any] = []

    def call(self, func_name: str, obs: Any = None) -> Any:
        if func_name == "update_obs_batch":
            obs = [(each["env_idx"], each["state"]["x"].tolist()) for each in obs]
        self.log.append((func_name, obs))
        return [[ON, ON] for _ in obs] if func_name == "get_action_batch" else None


def test_indices_and_the_shrinking_list_are_those_of_one_process(client: Path) -> None:
    together = load_module(client).make({"num_envs": 5})
    with contextlib.closing(VectorEnv(client, {"num_envs": 5}, workers=3)) as apart:

        @settings(max_examples=examples(30), deadline=None)
        @given(st.lists(st.integers(0, 6), min_size=5, max_size=5), st.permutations(range(5)))
        def equal(lengths: list[int], order: list[int]) -> None:
            played = []
            for env in (apart, together):
                env.reset(lengths)
                policy = Recorder()
                env.take_action_batch([ON] * 2, order[:2])
                seen = [(obs["env_idx"], obs["state"]["x"].tolist()) for obs in env.get_obs_batch(order)]
                played.append((seen, run_batch(env, policy), policy.log))
            assert played[0] == played[1]

        equal()


# -- misfortunes -------------------------------------------------------------------------------------------------------


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("hang", "did not answer within 0.5 s"),
        ("die", "SIGKILL"),
        ("exit", "exit code 3"),
        ("raise", "RuntimeError: the gears are jammed"),
    ],
)
def test_a_misfortune_spoils_its_own_episodes_and_no_others(
    start: Callable[..., VectorEnv], what: str, said: str
) -> None:
    """Environments of the same worker are lost, those that had ended before keep their result, others go on."""
    env = start({"num_envs": 5}, workers=2, limits=EnvTimeouts(step_s=0.5))
    env.reset([1, 9, 9, 9, 2])
    env.take_action_batch([ON] * 5, range(5))
    assert env.get_running_env_idx_list() == [1, 2, 3, 4]
    reports = env.take_action_batch([ON, {"do": what}, ON, ON], [4, 1, 2, 3])
    assert [report.get("end_reason") for report in reports] == [None, INFRASTRUCTURE, None, None]
    assert env.get_running_env_idx_list() == [2, 3]
    # Loops that were just told of an environment may still ask for it: it shows what it showed last.
    assert [obs["state"]["x"].tolist() for obs in env.get_obs_batch([1, 3])] == [[9, 0], [9, 2]]
    results = env.results()
    assert [result["end_reason"] for result in results] == ["success", INFRASTRUCTURE, None, None, "success"]
    assert results[1]["success"] is None
    assert said in results[1]["error"]
    assert results[1]["seed"] == 9
    env.reset([3] * 5)
    env.take_action_batch([ON] * 5, range(5))
    assert [result["steps"] for result in env.results()] == [1] * 5


def test_a_worker_killed_from_outside_is_replaced_at_the_next_reset(start: Callable[..., VectorEnv]) -> None:
    env = start({"num_envs": 2}, workers=2)
    env.reset([5, 5], {"colour": "red"})
    first, second = env.pids
    os.kill(second, signal.SIGKILL)
    assert [obs["pid"] for obs in env.get_obs_batch()] == [first, second]
    assert env.get_running_env_idx_list() == [0]
    assert "SIGKILL" in env.results()[1]["error"]
    env.reset([5, 5])
    assert first in env.pids
    assert second not in env.pids
    assert [obs["options"] for obs in env.get_obs_batch()] == [{"colour": "red"}] * 2


def test_a_loop_goes_on_when_an_environment_is_lost(start: Callable[..., VectorEnv]) -> None:
    env = start({"num_envs": 3}, workers=3)
    env.reset([6, 4, 5])
    victim = env.pids[1]

    class Killer(Recorder):
        def call(self, func_name: str, obs: Any = None) -> Any:
            if func_name == "get_action_batch" and len(self.log) > 2:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(victim, signal.SIGKILL)
            return super().call(func_name, obs)

    policy = Killer()
    results = run_batch(env, policy)
    assert [result["end_reason"] for result in results] == ["success", INFRASTRUCTURE, "success"]
    assert [obs for name, obs in policy.log if name == "get_action_batch"] == [[0, 1, 2], [0, 1, 2], [0, 2]]


def test_an_environment_lost_in_reset_never_runs(start: Callable[..., VectorEnv]) -> None:
    env = start({"num_envs": 1})
    env.reset([3], {"misfortune": "die"})
    assert env.is_episode_end()
    assert env.results()[0]["end_reason"] == INFRASTRUCTURE
    with pytest.raises(EnvLostError, match="SIGKILL"):
        env.get_obs()


def test_a_refused_action_is_no_misfortune(start: Callable[..., VectorEnv]) -> None:
    env = start({"num_envs": 2}, workers=2)
    env.reset([5, 5])
    with pytest.raises(ActionError, match="no such action"):
        env.take_action_batch([{"do": "refuse"}, ON], [0, 1])
    env.take_action_batch([ON, ON], [1, 0])
    assert [result["steps"] for result in env.results()] == [1, 2]


def test_what_cannot_travel_is_sent_to_nobody(start: Callable[..., VectorEnv]) -> None:
    env = start({"num_envs": 2}, workers=2)
    env.reset([5, 5])
    with pytest.raises(ValueError, match="cannot be sent"):
        env.take_action_batch([ON, {"do": object()}], [0, 1])
    env.take_action_batch([ON, ON], [0, 1])
    assert [result["steps"] for result in env.results()] == [1, 1]


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("what", "error", "said"),
    [
        ("value", ValueError, "^no such value$"),
        ("raise", EnvRaisedError, "RuntimeError: the gears are jammed"),
        ("die", EnvLostError, "SIGKILL"),
        ("hang", EnvLostError, "did not answer within 2 s"),
    ],
)
def test_an_environment_that_cannot_be_made_leaves_nothing(
    start: Callable[..., VectorEnv], what: str, error: type[Exception], said: str
) -> None:
    with pytest.raises(error, match=said):
        start({"num_envs": 2, "misfortune": what}, workers=2, limits=EnvTimeouts(start_s=2.0))


@pytest.mark.parametrize(("count", "workers"), [(2, 3), (2, 0)])
def test_more_workers_than_environments_are_refused(client: Path, count: int, workers: int) -> None:
    with pytest.raises(ValueError, match="1 to 2 workers"):
        VectorEnv(client, {"num_envs": count}, workers=workers)


# -- processes ---------------------------------------------------------------------------------------------------------


def test_nothing_outlives_a_parent_that_is_killed(client: Path, tmp_path: Path) -> None:
    """And each environment is closed to the end, although nobody reads any more what it prints."""
    mark = uuid.uuid4().hex
    code = """
        import sys
        from pathlib import Path
        from xpl.vector import VectorEnv
        env = VectorEnv(Path(sys.argv[1]), {"num_envs": 2, "child": True, "closed": sys.argv[2]}, workers=2)
        env.reset([5, 5])
        print("ready", flush=True)
        env.take_action_batch([{"do": "hang"}, {"do": "go on"}], [0, 1])
    """
    closed = tmp_path / "closed"
    closed.mkdir()
    parent = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code), str(client), str(closed)],
        cwd=ROOT, env={**os.environ, MARK: mark}, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert parent.stdout is not None
    with parent.stdout as out:
        assert out.readline() == "ready\n"
        wait_until(lambda: len(processes(mark)) == 5, "the parent, two workers and their children run")
        parent.kill()
        parent.wait()
    wait_until(lambda: not processes(mark), "all of them are gone")
    assert len(list(closed.iterdir())) == 2


def test_another_interpreter_needs_no_sdk_of_its_own(
    start: Callable[..., VectorEnv], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The SDK comes along, nothing else does; what the environment prints goes to standard error; it is closed."""
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nXPL_TEST_WRAPPED=yes PYTHONPATH= exec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    env = start({}, python=str(python))
    env.reset([1])
    assert env.get_obs()["variable"] == "yes"
    env.close()
    told = capfd.readouterr()
    assert told.out == ""
    assert told.err.split() == ["made", "closed"]


def test_an_environment_lives_in_an_old_python(start: Callable[..., VectorEnv], old_python: str) -> None:
    env = start({"num_envs": 2}, workers=2, python=old_python)
    env.reset([2, 1])
    assert [result["steps"] for result in run_batch(env, Recorder())] == [2, 1]


def test_an_interpreter_that_does_not_exist_is_named(client: Path) -> None:
    with pytest.raises(FileNotFoundError, match="/nowhere/python"):
        VectorEnv(client, {}, python="/nowhere/python")
