"""`xpl eval`: real servers and environments, thin scripts, the line that launchers wait for."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import textwrap
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from tests.support.peer import xpl
from tests.support.places import ROOT
from tests.support.recordings.runs import episode
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.runs import look
from xpl_cli.evaluation.runs.outcome import Evaluation, Played
from xpl_cli.evaluation.runs.settings import with_robot
from xpl_cli.packages import environments, package
from xpl_cli.standard.validate import validate

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from xpl_cli.serving.launch import RunningServer


@pytest.mark.slow
@pytest.mark.parametrize("task", ["lift_cube", "handover_block"])
def test_expert_20_of_20_and_demo_policy_0_of_20(tmp_path: Path, task: str) -> None:
    """The tasks are solvable, and not by standing still."""
    for policy, won in (("scripted_expert", 20), ("demo_policy", 0)):
        options = ["--env", "mujoco", "--task", task, "--episodes", "20", "--json"]
        done = xpl("eval", policy, *options, cwd=tmp_path)
        assert done.returncode == ExitCode.CLEAN, done.stderr
        assert json.loads(done.stdout)["successes"] == won


@pytest.mark.slow
def test_a_batch_of_environments_runs_as_many_episodes_as_asked_for(tmp_path: Path) -> None:
    """Three episodes, two at a time, each with its own seed."""
    options = ["--env", "mujoco", "--task", "lift_cube", "--episodes", "3", "--num-envs", "2", "--seed", "5", "--json"]
    report = json.loads(xpl("eval", "scripted_expert", *options, cwd=tmp_path).stdout)
    assert [episode["seed"] for episode in report["episodes"]] == [5, 6, 7]
    assert report["successes"] == 3


@pytest.mark.slow
def test_several_tasks_are_played_by_one_server_and_told_apart(tmp_path: Path) -> None:
    """A list, as splits are; seeds begin anew with each task, and the report is of all."""
    options = ["--env", "mujoco", "--task", "lift_cube,push_block", "--set", "env_cfg_type=arx_x5_single"]
    said = xpl("eval", "scripted_expert", *options, cwd=tmp_path)
    assert said.stdout.splitlines()[1:3] == ["  lift_cube: 1 of 1", "  push_block: 1 of 1"]
    done = xpl("eval", "scripted_expert", *options, "--json", cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    report = json.loads(done.stdout)
    assert validate(report, "evaluation") == []
    assert report["task"] == "lift_cube,push_block"
    played = [(episode["task"], episode["seed"], episode["success"]) for episode in report["episodes"]]
    assert played == [("lift_cube", 0, True), ("push_block", 0, True)]


@pytest.mark.slow
def test_the_scripts_of_a_scaffold_run_a_debug_evaluation(tmp_path: Path) -> None:
    """eval.sh with the ten positional arguments of the ecosystem ends with the line that launchers look for."""
    assert xpl("new-policy", "Foo", cwd=tmp_path).returncode == ExitCode.CLEAN
    tool = tmp_path / "xpl"
    tool.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m xpl_cli "$@"\n')
    tool.chmod(0o755)
    arguments = ["my bench", "echo", "ckpt", "arx_x5", "joint", "0", "0", "0", "none", "none"]
    environment = {**os.environ, "EVAL_ENV_TYPE": "debug", "XPL": str(tool)}
    done = subprocess.run(
        ["/bin/bash", str(tmp_path / "policy/Foo/eval.sh"), *arguments],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[MAIN] eval finished"


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["--env", "mujoco", "--task", "fold_shirt"], ExitCode.NOT_FOUND, "lift_cube"),
        (["--env", "isaac"], ExitCode.NOT_FOUND, "mujoco, offline"),
        (["--env", "mujoco", "--set", "env_cfg_type=franka"], ExitCode.USAGE, "has no franka"),
        (["--set", "seed"], ExitCode.USAGE, "KEY=VALUE"),
    ],
)
def test_what_cannot_be_evaluated_is_refused_in_one_sentence(
    tmp_path: Path, options: list[str], code: ExitCode, said: str
) -> None:
    """The message lists what there is; no traceback."""
    done = xpl("eval", "demo_policy", *options, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (code, "")
    assert said in done.stderr
    assert "Traceback" not in done.stderr


BREAKS_ONCE = """
    import os, signal
    from pathlib import Path
    import numpy as np

    class Model:
        def __init__(self, config):
            self.config = config
            self.calls = 0

        def reset(self): pass
        def update_obs(self, obs): self.state = obs["state"]
        def update_obs_batch(self, obs_list): self.update_obs(obs_list[-1])

        def get_action(self):
            self.calls += 1
            left = int(Path(self.config["marks"]).read_text())
            if self.calls == 3 and left:
                Path(self.config["marks"]).write_text(str(left - 1))
                os.kill(os.getpid(), signal.SIGKILL)
            keys = ("arm_joint_state", "ee_joint_state")
            return [{key: np.asarray(self.state[key], np.float32) for key in keys}]
"""


@pytest.mark.slow
@pytest.mark.parametrize("deaths", [1, 9])
def test_a_policy_whose_process_dies_is_asked_again_and_has_failed_in_the_end(
    write_adapter: Callable[..., Path], tmp_path: Path, deaths: int
) -> None:
    """It is played again with a new server; who dies in every attempt has failed, which ends the evaluation."""
    adapter = write_adapter(BREAKS_ONCE)
    deploy = {"env_cfg_type": "franka_single", "marks": str(tmp_path / "marks")}
    (adapter / "deploy.yml").write_text(json.dumps(deploy), encoding="utf-8")
    shutil.copy(ROOT / "policy" / "demo_policy" / "deploy.py", adapter)
    (tmp_path / "marks").write_text(str(deaths), encoding="utf-8")
    done = xpl("eval", str(adapter), "--env", "offline", "--episodes", "2", "--json", cwd=tmp_path)
    assert "SIGKILL" in done.stderr
    answer = json.loads(done.stdout)
    if deaths == 1:
        assert done.returncode == ExitCode.CLEAN, done.stderr
        assert validate(answer, "evaluation") == []
        assert [(episode["seed"], episode["attempts"]) for episode in answer["episodes"]] == [(0, 2), (1, 1)]
        assert answer["infrastructure_failures"] == 0
    else:
        assert (done.returncode, answer["schema"]) == (ExitCode.FINDINGS, "xpl.error/1")
        assert "episode with seed 0: " in answer["message"]
        assert "SIGKILL" in answer["message"]


def test_a_policy_that_does_not_fit_is_refused_before_the_first_step(
    write_adapter: Callable[..., Path], tmp_path: Path
) -> None:
    """The manifest asks for another rate than the environment has."""
    adapter = write_adapter(BREAKS_ONCE, control_frequency=50, inputs={"required": ["state.mobile"]})
    shutil.copy(ROOT / "policy" / "demo_policy" / "deploy.py", adapter)
    done = xpl("eval", str(adapter), "--env", "offline", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (ExitCode.USAGE, "")
    assert "50 Hz" in done.stderr
    assert "state.mobile" in done.stderr


# -- environments in processes -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["0", "2"])
def test_the_record_of_an_episode_does_not_depend_on_who_plays_it(tmp_path: Path, workers: str) -> None:
    """Seed, layout, wording, steps and digest are equal here and in other processes; the report is as specified."""
    options = [
        "--env",
        "mujoco",
        "--task",
        "lift_cube",
        "--setting",
        "randomized",
        "--episodes",
        "2",
        "--num-envs",
        "2",
    ]
    done = xpl("eval", "scripted_expert", *options, "--workers", workers, "--horizon", "5", "--json", cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    report = json.loads(done.stdout)
    assert validate(report, "evaluation") == []
    assert (report["setting"], report["horizon"], report["workers"]) == ("randomized", 5, int(workers))
    played = environments.make(
        "mujoco",
        {"task": "lift_cube", "embodiment": "arx_x5", "num_envs": 2, "cameras": False, "setting": "randomized"},
    )
    played.reset([0, 1])
    for record, fresh in zip(report["episodes"], played.results(), strict=True):
        told = {key: record[key] for key in ("seed", "setting", "instruction", "layout")}
        assert told == {key: fresh[key] for key in told}
        assert (record["end_reason"], record["attempts"], record["corrections"]) == ("success", 1, {})
    pair = [[record[key] for key in ("steps", "digest")] for record in report["episodes"]]
    assert _same_for_all.setdefault("pair", pair) == pair


_same_for_all: dict[str, object] = {}

FRAIL = """
    import os, signal
    from pathlib import Path
    import numpy as np

    class Env:
        def __init__(self, config):
            self.count = config["num_envs"]

        def reset(self, seed=None, options=None):
            self.seeds, self.steps = list(seed), [0] * self.count

        def get_obs(self):
            return self.get_obs_batch([0])[0]

        def get_obs_batch(self, env_idx_list=None):
            joints = np.array([0, 0, 0, -1, 0, 1, 0], np.float32)
            state = {"arm_joint_state": joints, "ee_joint_state": np.ones(1, np.float32)}
            return [{"env_idx": env, "instruction": "hold on", "state": dict(state)} for env in env_idx_list]

        def take_action(self, action):
            self.take_action_batch([action], [0])

        def take_action_batch(self, actions, env_idx_list):
            for env in env_idx_list:
                self.steps[env] += 1
                deaths = Path(__file__).with_name(f"deaths-{self.seeds[env]}")
                if self.steps[env] == 3 and deaths.exists() and int(deaths.read_text()):
                    deaths.write_text(str(int(deaths.read_text()) - 1))
                    os.kill(os.getpid(), signal.SIGKILL)

        def is_episode_end(self):
            return not self.get_running_env_idx_list()

        def get_running_env_idx_list(self):
            return [env for env, steps in enumerate(self.steps) if steps < 4]

        def results(self):
            return [
                {"env_idx": env, "seed": seed, "success": True, "score": 1.0, "steps": steps, "end_reason": "success"}
                for env, (seed, steps) in enumerate(zip(self.seeds, self.steps, strict=True))
            ]

        def close(self):
            pass

    def make(config):
        return Env(config)
"""


@pytest.fixture
def frail(tmp_path: Path) -> Path:
    """Return an environment that does not keep its robot's limits, and dies as often as a file tells."""
    folder = tmp_path / "envs" / "frail"
    folder.mkdir(parents=True)
    task = {"instruction": "hold on", "max_steps": 4}
    facts = {
        "spec": "v1", "name": "frail", "title": "Frail", "embodiments": ["franka_single"], "action_types": ["joint"],
        "cameras": {}, "control_frequency": 25, "tasks": {"hold": task}, "client": "client.py",
    }  # fmt: skip
    (folder / "env.yml").write_text(json.dumps(facts), encoding="utf-8")
    (folder / "client.py").write_text(textwrap.dedent(FRAIL), encoding="utf-8")
    return folder


HOLD = ["--env", "frail", "--set", "env_cfg_type=franka_single", "--json"]


WILD = """
    import numpy as np

    class Model:
        def __init__(self, config):
            self.config = config

        def reset(self): pass
        def update_obs(self, obs): self.state = obs["state"]
        def update_obs_batch(self, obs_list): self.update_obs(obs_list[-1])
        def get_action_batch(self, env_idx_list=None): return [self.get_action() for _ in env_idx_list]

        def get_action(self):
            far = self.state["arm_joint_state"] + np.float32(self.config["far"])
            return [{"arm_joint_state": far, "ee_joint_state": self.state["ee_joint_state"]}]
"""


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("loop", "far", "reason", "kind"),
    [
        ([], "1.0", "far_first_action", "far_first_action"),
        (["--horizon", "1"], ".nan", "non_finite_action", "non_finite_action"),
        (["--horizon", "1"], "0.1", "success", "joint_speed"),
    ],
    ids=["far", "nan", "fast"],
)
def test_what_does_not_keep_its_limits_is_guarded(  # noqa: PLR0917 - fixtures and parameters
    frail: Path, write_adapter: Callable[..., Path], tmp_path: Path, loop: list[str], far: str, reason: str, kind: str
) -> None:
    """In either loop; the record tells what was corrected, where and how far."""
    adapter = write_adapter(WILD)
    shutil.copy(ROOT / "policy" / "demo_policy" / "deploy.py", adapter)
    done = xpl("eval", str(adapter), *HOLD, *loop, "--set", f"far={far}", cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    report = json.loads(done.stdout)
    assert validate(report, "evaluation") == []
    (record,) = report["episodes"]
    assert record["end_reason"] == reason
    assert record["safety"][kind]["where"] in ("arm_joint_state", "joint1", "joint4")
    assert report["corrections"][kind] == record["safety"][kind]["count"]


@pytest.mark.slow
def test_what_runs_in_real_time_is_driven_by_servers_that_ask_for_a_token_only(
    frail: Path, write_adapter: Callable[..., Path], serve: Callable[..., RunningServer], tmp_path: Path
) -> None:
    """Those that an evaluation starts do; another one is refused before the first step."""
    facts = json.loads((frail / "env.yml").read_text())
    (frail / "env.yml").write_text(json.dumps({**facts, "real_time": True}), encoding="utf-8")
    adapter = write_adapter(WILD)
    play = ("eval", str(adapter), *HOLD, "--horizon", "1", "--set", "far=0.0")
    own = xpl(*play, cwd=tmp_path)
    assert own.returncode == ExitCode.CLEAN, own.stderr
    other = xpl(*play, "--connect", serve(adapter, overrides={"far": 0.0}).url, cwd=tmp_path)
    assert other.returncode == ExitCode.USAGE
    assert "asks for no token: start it with --token-file" in other.stderr


SLOW = WILD.replace("def get_action(self):", "def get_action(self):\n            import time; time.sleep(0.5)")


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("real_time", "held"), [(True, 4), (False, None)])
def test_actions_age_unless_the_environment_waits(
    frail: Path, write_adapter: Callable[..., Path], tmp_path: Path, *, real_time: bool, held: int | None
) -> None:
    """A model that thinks for twelve control steps is too slow for a robot, and not for a simulation."""
    facts = json.loads((frail / "env.yml").read_text())
    (frail / "env.yml").write_text(json.dumps({**facts, "real_time": real_time}), encoding="utf-8")
    done = xpl("eval", str(write_adapter(SLOW)), *HOLD, "--horizon", "1", "--set", "far=0.0", cwd=tmp_path)
    assert json.loads(done.stdout)["corrections"].get("action_age") == held


def test_an_adapter_without_a_loop_is_driven_with_a_horizon(
    frail: Path, write_adapter: Callable[..., Path], tmp_path: Path
) -> None:
    """deploy.py is needed only where it is what runs."""
    adapter = write_adapter(WILD)
    assert xpl("eval", str(adapter), *HOLD, "--set", "far=0.0", cwd=tmp_path).returncode == ExitCode.NOT_FOUND
    done = xpl("eval", str(adapter), *HOLD, "--set", "far=0.0", "--horizon", "3", cwd=tmp_path)
    assert json.loads(done.stdout)["successes"] == 1


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["--setting", "dusty"], ExitCode.NOT_FOUND, "clean"),
        (["--eval-env", "venv:nowhere"], ExitCode.NOT_RUN, "nowhere/bin/python"),
    ],
)
def test_where_an_environment_cannot_be_played_one_sentence_says_so(
    frail: Path, tmp_path: Path, options: list[str], code: ExitCode, said: str
) -> None:
    """Before a server is started."""
    done = xpl("eval", "demo_policy", *HOLD, *options, cwd=tmp_path)
    assert done.returncode == code
    answer = json.loads(done.stdout)
    assert (answer["schema"], answer["exit_code"]) == ("xpl.error/1", code)
    assert said in answer["message"]
    assert answer["message"] in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_the_environment_runs_in_the_python_it_is_given(frail: Path, tmp_path: Path) -> None:
    """`--eval-env` names an environment as `--policy-env` does; another one than ours needs a process."""
    python = tmp_path / "place" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(f'#!/bin/sh\necho used >> "{tmp_path}/used"\nexec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    options = [*HOLD, "--eval-env", f"venv:{tmp_path}/place"]
    refused = xpl("eval", "demo_policy", *options, "--workers", "0", cwd=tmp_path)
    assert refused.returncode == ExitCode.USAGE
    assert "at least one worker" in refused.stderr
    done = xpl("eval", "demo_policy", *options, cwd=tmp_path)
    assert json.loads(done.stdout)["successes"] == 1, done.stderr
    assert (tmp_path / "used").read_text() == "used\n"


# -- processes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("num_envs", "workers", "wanted"),
    [
        (None, "1", (1, 1)),
        (None, "0", (1, 0)),
        (None, "3", (3, 3)),
        (8, "2", (8, 2)),
        (8, "0", (8, 0)),
        (1, "auto", (1, 1)),
    ],
)
def test_environments_and_workers(num_envs: int | None, workers: str, wanted: tuple[int, int]) -> None:
    """One environment for each worker unless told otherwise."""
    assert look.places(num_envs, workers) == wanted


def test_automatic_workers_are_as_many_as_cores() -> None:
    """And no more than there are environments."""
    cores = len(os.sched_getaffinity(0))
    assert look.places(None, "auto") == (cores, cores)
    assert look.places(cores + 5, "auto") == (cores + 5, cores)


@pytest.mark.parametrize(
    ("num_envs", "workers", "said"), [(2, "3", "3 workers for 2 environments"), (None, "many", "a number or auto")]
)
def test_workers_that_cannot_be_are_refused(num_envs: int | None, workers: str, said: str) -> None:
    """One sentence."""
    with pytest.raises(UserError, match=said):
        look.places(num_envs, workers)


SEES = """
    import numpy as np

    class Model:
        def __init__(self, config): pass
        def reset(self): pass
        def update_obs_batch(self, obs_list): self.update_obs(obs_list[-1])

        def update_obs(self, obs):
            self.state = obs["state"]
            sizes = {camera["color"].shape for camera in obs["vision"].values()}
            assert sizes == {(96, 128, 3)}, sizes

        def get_action(self):
            keys = ("arm_joint_state", "ee_joint_state")
            return [{key: np.asarray(self.state[key], np.float32) for key in keys}]
"""


@pytest.mark.sampled(1)
@pytest.mark.parametrize("environment", ["offline", "mujoco"])
def test_an_environment_renders_what_the_policy_declares(
    write_adapter: Callable[..., Path], tmp_path: Path, environment: str
) -> None:
    """Images of the declared size; where one environment cannot show all, the handshake names the one that is wrong."""
    adapter = write_adapter(SEES)
    manifest = {
        "spec": "v1",
        "inputs": {"required": ["vision.cam_head", "state.arm_joint_state"], "optional": [], "unused": []},
        "cameras": {"cam_head": {"width": 128, "height": 96, "exact": True}},
    }
    (adapter / "policy.yml").write_text(json.dumps(manifest), encoding="utf-8")
    options = ["--env", environment, "--horizon", "1", "--set", "env_cfg_type=franka_single", "--json"]
    short = ["--task", "echo"] if environment == "offline" else ["--task", "lift_cube"]
    done = xpl("eval", str(adapter), *options, *short, cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stderr

    manifest["cameras"]["cam_wrist"] = {"width": 256, "height": 96, "exact": True}
    (adapter / "policy.yml").write_text(json.dumps(manifest), encoding="utf-8")
    done = xpl("eval", str(adapter), *options, *short, cwd=tmp_path)
    assert done.returncode == ExitCode.USAGE
    assert "the policy needs cam_head 128 x 96, the environment shows 256 x 96" in done.stderr


@pytest.mark.parametrize(
    ("environment", "robot"), [("metaworld", None), ("libero", "panda_libero"), ("maniskill", "panda_maniskill")]
)
def test_the_robot_is_the_first_that_policy_and_environment_both_have(environment: str, robot: str | None) -> None:
    """The policy's own first one if the environment has that; whoever names one is heard."""
    expert = package.load(ROOT / "policy" / "benchmark_expert")
    wanted = {} if robot is None else {"env_cfg_type": robot}
    assert with_robot(expert, environment, {"seed": 3}) == {"seed": 3, **wanted}
    assert with_robot(expert, environment, {"env_cfg_type": "aloha"}) == {"env_cfg_type": "aloha"}
    named = replace(expert, deploy={**expert.deploy, "env_cfg_type": "so100"})
    assert with_robot(named, environment, {}) == {}


def test_an_episode_that_is_spoilt_for_good_counts_as_failed() -> None:
    """Without a verdict nobody can tell who was to blame; where no episode has a success, there is no rate."""
    won = episode()
    spoilt = episode(success=None, score=None, end_reason="infrastructure", failure="infrastructure")
    played = Played("Foo", "mujoco", "lift_cube", "clean", "arx_x5", "joint")
    told = Evaluation(played, [won, spoilt])
    assert (told.successes, told.success_rate, told.mean_score, told.spoilt) == (1, 0.5, 0.5, 1)
    assert Evaluation(played, [spoilt]).success_rate is None
    assert validate(told.as_json(), "evaluation") == []
