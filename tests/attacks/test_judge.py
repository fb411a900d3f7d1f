"""Adapters that attack whoever judges them: in their evaluation loop, in their model, in what they send."""

from __future__ import annotations

import json
import os
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.adapters import drill
from tests.support.checkout import ROOT, copy
from tests.support.peer import wait_until, xpl
from xpl_cli.basics.errors import ExitCode
from xpl_cli.evaluation.loop.process import AdapterLoop, LoopLostError, LoopRaisedError, LoopTimeouts
from xpl_cli.evaluation.loop.request_handler import EndlessLoopError
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.records.cells import retried_after_crash
from xpl_cli.isolation.isolation_settings import IsolationSettings
from xpl_cli.packages import environments

FORGED = """
    import atexit, gc, os, signal, sys, threading

    def forge(*arguments, **options):
        return {"success": True, "score": 1.0, "failure": None, "end_reason": "success", "steps": 1}

    def attack():
        import xpl_cli.evaluation.records.failures as failures
        failures.outcome_of = failures.policy_error = failures.infrastructure_error = forge
        for name, module in list(sys.modules.items()):
            if name.startswith(("xpl_cli", "xpl.")):
                for key in ("outcome_of", "policy_error", "infrastructure_error", "results", "exit_code"):
                    if hasattr(module, key):
                        setattr(module, key, forge)
        for found in gc.get_objects():
            if type(found).__name__ in ("TelemetryWrapper", "VectorEnv", "RolloutWorker", "GuardedEnv"):
                type(found).results = lambda self: [forge()]

    attack()
    atexit.register(os._exit, 0)
    threading.Thread(target=signal.pause).start()
    signal.signal(signal.SIGTERM, signal.SIG_IGN)

    def eval_one_episode(TASK_ENV, model_client):
        attack()
        TASK_ENV.results = lambda: [forge()]
        model_client.call(func_name="reset")

    eval_one_episode_batch = eval_one_episode
"""


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """Return a folder with the drill's environment and adapter in it."""
    drill.environment(tmp_path)
    drill.adapter(tmp_path)
    return tmp_path


def _deploy(room: Path, code: str) -> None:
    (room / "policy" / "Drilled" / "deploy.py").write_text(textwrap.dedent(code), encoding="utf-8")


def _eval(room: Path, *options: str) -> Any:
    return xpl("eval", "Drilled", "--env", "drill", *options, cwd=room)


def test_a_loop_that_forges_the_judge_of_a_recorded_run_has_failed(room: Path) -> None:
    """It patches what it can reach and never moves: not one of its episodes succeeds."""
    _deploy(room, FORGED)
    _eval(room, "--out", "run", "--episodes", "2", "--film", "0", "--json")
    finals = records.read(room / "run").finals
    assert [line.success for line in finals.values()] == [False, False]
    assert {line.failure for line in finals.values()} == {"policy"}


_SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("where", "end"),
    [
        ("import", "sys.exit()"),
        ("loop", "os._exit(0)"),
        *(
            pytest.param(where, end, marks=_SLOW)
            for where, end in [
                ("import", "os._exit(0)"),
                ("import", "os.kill(os.getpid(), 9)"),
                ("loop", "sys.exit()"),
                ("loop", "os.kill(os.getpid(), 9)"),
            ]
        ),
    ],
)
def test_an_exit_in_deploy_py_is_no_verdict(room: Path, where: str, end: str) -> None:
    """Neither when it is imported nor when it plays does it end an evaluation with 0, or without a sentence."""
    loop = f"def eval_one_episode(a, b):\n    {end if where == 'loop' else 'pass'}\n"
    _deploy(room, f"import os, sys\n{loop}\n{end if where == 'import' else ''}\n")
    done = _eval(room, "--json")
    assert done.returncode == (ExitCode.NOT_RUN if where == "import" else ExitCode.FINDINGS), done.stderr
    assert "error: " in done.stderr
    assert "eval finished" not in done.stdout


REACHES = """
    import ctypes, glob, os, signal

    def eval_one_episode(TASK_ENV, model_client):
        own = os.getpid()
        libc = ctypes.CDLL(None)
        libc.umount2(b"/proc", 2)  # as root, what lies below it is the machine's
        if libc.unshare(1 << 28 | 1 << 17) == 0:
            libc.umount2(b"/proc", 2)
        for pid in [os.getppid(), *(int(path.split("/")[2]) for path in glob.glob("/proc/[0-9]*"))]:
            if pid not in (0, 1, own):
                open(f"/proc/{pid}/mem", "r+b").close()
                os.kill(pid, signal.SIGKILL)
        if os.getppid() > 1:
            raise RuntimeError(f"it sees process {os.getppid()}")
        model_client.call(func_name="reset")
        model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())
        while not TASK_ENV.is_episode_end():
            for action in model_client.call(func_name="get_action"):
                TASK_ENV.take_action(action)
                if TASK_ENV.is_episode_end():
                    break
                model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())

    eval_one_episode_batch = eval_one_episode
"""


@pytest.mark.skipif(
    not IsolationSettings.strictest(ROOT, isolate=False).apart, reason="the system has no PID namespaces"
)
def test_a_loop_neither_sees_nor_signals_the_process_that_judges(room: Path) -> None:
    """It kills and opens the memory of all that it sees, which is nothing: its episode ends as any other."""
    _deploy(room, REACHES)
    done = _eval(room, "--json")
    assert done.returncode == ExitCode.CLEAN, done.stderr
    assert json.loads(done.stdout)["successes"] == 1


# -- the loop's process, seen from the judge ---------------------------------------------------------------------------


class _World:
    """An environment of one episode of three steps, and a policy; both note what is asked of them."""

    def __init__(self) -> None:
        self.left, self.asked = 3, list[str]()
        self.image = np.zeros((64, 96, 3), np.uint8)
        self.shown: Any = None

    def get_running_env_idx_list(self) -> list[int]:
        return [0] if self.left > 0 else []

    def get_obs(self) -> dict[str, Any]:
        self.asked.append("get_obs")
        return {"vision": {"cam_head": {"color": self.image}}, "state": {"arm_joint_state": np.zeros(7, np.float32)}}

    def take_action(self, action: Any) -> dict[str, Any]:
        assert isinstance(action, dict)
        self.left -= 1
        return {"step": 3 - self.left}

    def results(self) -> list[dict[str, Any]]:
        return [{"env_idx": 0, "seed": 4, "success": False, "layout": {"cube": [0.1, 0.2]}, "digest": "ab", "steps": 0}]

    def reset(self) -> None:
        self.asked.append("reset")

    def call(self, func_name: str, obs: Any = None) -> Any:
        self.asked.append(func_name)
        if func_name == "update_obs":
            self.shown = obs
        return [{"arm_joint_state": np.zeros(7, np.float32)}] if func_name == "get_action" else None


@dataclass
class _Stage:
    """A loop that runs the statements that it is given, in one process for as long as that lives.

    Attributes:
        folder: of its adapter.
        loop: its process.
    """

    folder: Path
    loop: AdapterLoop

    def play(self, body: str) -> _World:
        """Run statements as a loop, and return what was asked of environment and policy."""
        (self.folder / "body").write_text(textwrap.dedent(body), encoding="utf-8")
        world = _World()
        self.loop.run_trial(world, world, batch=False)
        return world


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[_Stage]:
    folder = tmp_path_factory.mktemp("adapter")
    body = "exec((Path(__file__).parent / 'body').read_text(), {'env': env, 'policy': policy, '__file__': __file__})"
    code = f"from pathlib import Path\ndef eval_one_episode(env, policy):\n    {body}\n"
    (folder / "deploy.py").write_text(code, encoding="utf-8")
    loop = AdapterLoop(folder, limits=LoopTimeouts(request_s=1.5), is_silent=True)
    yield _Stage(folder, loop)
    loop.close()


def test_a_loop_plays_through_stand_ins_and_images_travel_once(stage: _Stage) -> None:
    """What it passes on as it came is the judge's own array; what it changed arrives changed."""
    world = stage.play("policy.call(func_name='update_obs', obs=env.get_obs())")
    assert world.shown["vision"]["cam_head"]["color"] is world.image
    changed = "obs = env.get_obs()\nobs['vision']['cam_head']['color'] = obs['vision']['cam_head']['color'] + 1\n"
    world = stage.play(f"{changed}policy.call(func_name='update_obs', obs=obs)")
    np.testing.assert_array_equal(world.shown["vision"]["cam_head"]["color"], world.image + 1)


def test_a_loop_is_not_told_where_things_are(stage: _Stage) -> None:
    """Nor which seed it plays: an oracle would win where a policy has to look."""
    stage.play("told = env.results()\nassert told == [{'env_idx': 0, 'success': False, 'steps': 0}], told")


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("import os; os._exit(0)", "exit code 0"),
        ("import os; os.kill(os.getpid(), 11)", "SIGSEGV"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSTOP)", "did not answer within"),
        ("while True: pass", "did not answer within"),
        ("import os; os.closerange(3, 99); os._exit(0)", "evaluation loop"),
        ("env._evaluator._channel._socket.sendall(b'x' * 64)", "link"),
    ],
    ids=["exit", "segfault", "stopped", "spins", "hangs up", "garbage"],
)
def test_a_loop_that_ends_or_hangs_is_lost_with_a_reason(stage: _Stage, body: str, said: str) -> None:
    """Whatever ends it, the judge goes on and says what happened."""
    with pytest.raises(LoopLostError, match=said):
        stage.play(body)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("raise SystemExit", "raised SystemExit"),
        ("raise KeyboardInterrupt", "raised KeyboardInterrupt"),
        ("raise type('Odd', (BaseException,), {'__str__': lambda self: 1 / 0})", "raised Odd"),
        (r"raise ValueError('\ud800' * 5000)", "raised ValueError"),
        ("env.reset()", "may not use TASK_ENV.reset"),
        ("env.left = 0\nenv._env", "may not use TASK_ENV._env"),
        ("policy.__class__.call(policy)", "raised AttributeError"),
    ],
)
def test_a_loop_that_raises_says_what(stage: _Stage, body: str, said: str) -> None:
    """In a text that can be written down, whatever was raised; nothing but the surface is offered."""
    with pytest.raises(LoopRaisedError, match=said) as raised:
        stage.play(body)
    assert len(str(raised.value).encode()) < 1000


@pytest.mark.parametrize(
    "message",
    [
        "{'target': 'task_env', 'operation': 'reset'}",
        "{'target': 'task_env', 'operation': 'close'}",
        "{'target': ['task_env'], 'operation': {}}",
        "{'target': 'client', 'operation': '__class__'}",
        "{'raised': 7}",
        "[]",
    ],
)
def test_an_invalid_request_is_not_answered(stage: _Stage, message: str) -> None:
    """A loop that writes to the link itself gets no farther than one that uses the proxies."""
    body = f"channel = env._evaluator._channel\nchannel.send({message}, [b''])\nchannel.receive()"
    with pytest.raises(LoopLostError):
        stage.play(body)


def test_a_loop_that_never_acts_or_never_ends_is_broken_off(stage: _Stage) -> None:
    """After the end it may ask a little longer, and before it not for ever."""
    with pytest.raises(EndlessLoopError, match="does not notice"):
        stage.play("while True: env.take_action({})")
    with pytest.raises(EndlessLoopError, match="without a control step"):
        stage.play("while True: policy.call(func_name='update_obs', obs=None)")


def test_the_loops_process_inherits_nothing_but_its_link_and_leaves_nothing(stage: _Stage) -> None:
    """No descriptor of the judge, no terminal or log that could be read or emptied, and no process after the end."""
    kept = os.open(stage.folder, os.O_RDONLY)
    os.set_inheritable(kept, True)
    body = """
        import os, subprocess, json
        from pathlib import Path
        held = [os.readlink(f"/proc/self/fd/{n}") for n in sorted(map(int, os.listdir("/proc/self/fd")))
                if os.path.lexists(f"/proc/self/fd/{n}")]
        child = subprocess.Popen(["sleep", "600"], start_new_session=True)
        Path(__file__).with_name("told").write_text(json.dumps([held, child.pid]))
    """
    stage.loop.close()
    try:
        stage.play(body)
    finally:
        os.close(kept)
    stage.loop.close()
    held, child = json.loads((stage.folder / "told").read_text())
    kinds = [name.partition(":")[0] for name in held if not name.startswith("/proc")]
    assert set(kinds[:3]) <= {os.devnull, "pipe"}
    assert kinds[3:] == ["socket"]
    wait_until(lambda: not Path(f"/proc/{child}/cmdline").exists() or not _lives(child), "the loop's child is gone")


def _lives(pid: int) -> bool:
    return " Z " not in Path(f"/proc/{pid}/stat").read_text()


# -- ending in place of losing -----------------------------------------------------------------------------------------

_FAILS = """
    def eval_one_episode(env, policy):
        import os
        policy.call(func_name="reset")
        obs = env.get_obs()
        policy.call(func_name="update_obs", obs=obs)
        seed = int(obs["instruction"].removeprefix("seed "))
        if seed % 3 == 2:
            END
        while not env.is_episode_end():
            for action in policy.call(func_name="get_action"):
                env.take_action(action)
                if env.is_episode_end():
                    break
                policy.call(func_name="update_obs", obs=env.get_obs())
"""


@pytest.mark.slow
@pytest.mark.parametrize("end", ["os._exit(0)", pytest.param("os.kill(os.getpid(), 11)", marks=_SLOW)])
def test_a_loop_that_ends_itself_where_it_loses_gains_nothing(room: Path, end: str) -> None:
    """Every attempt of such an episode dies, and it counts as failed, like that of a twin that plays on and fails."""
    _deploy(room, _FAILS.replace("END", end))
    done = _eval(room, "--out", "cheat", "--episodes", "6", "--film", "0", "--json")
    _deploy(room, _FAILS.replace("END", "pass"))
    honest = _eval(room, "--out", "honest", "--episodes", "6", "--film", "0", "--json")
    assert (done.returncode, honest.returncode) == (ExitCode.CLEAN, ExitCode.CLEAN), done.stderr
    rates = [json.loads(one.stdout)["overall"]["success_rate"] for one in (done, honest)]
    assert rates == [pytest.approx(4 / 6)] * 2
    finals = records.read(room / "cheat").finals
    assert [line.end_reason for line in finals.values() if line.failure] == ["policy_died"] * 2
    assert [line.attempt for line in finals.values() if line.failure] == [3, 3]


_NONSENSE = """
            for ask in (
                lambda: env.take_action(None),
                lambda: env.take_action({}),
                lambda: env.take_action("arm_joint_state"),
                lambda: env.take_action({"arm_joint_state": [[]] * 7, "ee_joint_state": [0.0]}),
                lambda: env.take_action({"arm_joint_state": [10**400] * 7, "ee_joint_state": [0.0]}),
                lambda: env.take_action({"arm_joint_state": [0.0] * 7, "ee_joint_state": [0.0], "x": None}),
                lambda: env.take_action_batch(None, [0]),
                lambda: env.take_action_batch([None], [0]),
                lambda: env.get_obs_batch([0] * 1000),
                lambda: env.render({}, []),
                lambda: env.render(0, {}),
                env.finish_episode,
            ):
                try:
                    ask()
                except Exception as error:
                    print(type(error).__name__, error)
            policy.call(func_name="update_obs", obs=env.get_obs())
"""


@pytest.mark.slow
def test_a_loop_that_makes_its_environment_raise_where_it_loses_gains_nothing(room: Path) -> None:
    """Nothing but actions of the robot reaches the environment, so no attempt is an infrastructure error."""
    client = room / "envs" / "drill" / "client.py"
    code = client.read_text()
    assert "def render(self, env_idx=0, camera=None):" in code
    code = code.replace(
        "def render(self, env_idx=0, camera=None):",
        "def finish_episode(self):\n        raise RuntimeError('it goes on')\n\n"
        "    def render(self, env_idx=0, camera=None):\n        hash(camera)",
    )
    client.write_text(code)
    _deploy(room, _FAILS.replace("END", _NONSENSE.strip()))
    done = _eval(room, "--out", "run", "--episodes", "6", "--film", "0", "--json")
    assert done.returncode == ExitCode.CLEAN, done.stderr
    finals = records.read(room / "run").finals
    assert [line.failure for line in finals.values()] == [None, None, "task"] * 2
    assert {line.attempt for line in finals.values()} == {1}


@pytest.mark.slow
def test_a_success_after_an_infrastructure_error_is_reported(room: Path) -> None:
    """The infrastructure was to blame as far as anybody saw; whoever reads the figures knows how many rest on that."""
    drill.mark(room / "envs" / "drill", "env-dies-0", 1)
    done = _eval(room, "--out", "run", "--episodes", "2", "--film", "0")
    assert done.returncode == ExitCode.CLEAN, done.stderr
    assert "1 episode succeeded after an attempt that ended with an infrastructure error" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("times", [1, 9], ids=["once", "always"])
def test_a_model_that_kills_itself_where_it_loses_gains_nothing(tmp_path: Path, times: int) -> None:
    """Nor does one that does so only in its first attempt, and may win the second."""
    drill.environment(tmp_path)
    drill.adapter(tmp_path)
    for seed in (0, 2):
        drill.mark(tmp_path, f"policy-dies-{seed}", times)
    done = _eval(tmp_path, "--out", "run", "--episodes", "6", "--film", "0", "--json")
    found = json.loads(done.stdout)["overall"]
    assert found["success_rate"] == pytest.approx(3 / 6)
    assert found["failures"]["infrastructure"] == 0
    assert found["successes"] == (4 if times == 1 else 3)
    run = records.read(tmp_path / "run")
    again = retried_after_crash(run.attempts)
    scores = [0.0 if index in again else line.score or 0.0 for index, line in run.finals.items()]
    assert found["mean_score"] == pytest.approx(sum(scores) / 6)


@pytest.mark.slow
def test_a_model_that_hangs_where_it_loses_gains_nothing(tmp_path: Path) -> None:
    """The server says that it hung while its client still waits: nobody takes that for a machine that failed."""
    drill.environment(tmp_path)
    drill.adapter(tmp_path, request_timeout_s=1.0)
    for seed in (0, 2):
        drill.mark(tmp_path, f"policy-hangs-{seed}", 1)
    done = _eval(tmp_path, "--out", "run", "--episodes", "6", "--film", "0", "--json")
    found = json.loads(done.stdout)["overall"]
    assert found["success_rate"] == pytest.approx(3 / 6)
    assert found["failures"]["infrastructure"] == 0
    assert found["successes"] == 4


@pytest.mark.slow
@pytest.mark.parametrize("where", ["import", "loop"])
def test_an_exit_in_deploy_py_never_ends_an_audit(tmp_path: Path, where: str) -> None:
    """The MuJoCo gate judges on: the loop is a finding, and the model is looked at by all other rules."""
    adapter = copy(tmp_path, "policy/demo_policy/**") / "policy/demo_policy"
    end = {"import": "import os\nos._exit(0)\n", "loop": ""}[where]
    body = "def eval_one_episode(TASK_ENV, model_client):\n    import os\n    os._exit(0)\n\n"
    (adapter / "deploy.py").write_text(f"{end}{body}eval_one_episode_batch = eval_one_episode\n", encoding="utf-8")
    done = xpl("audit", str(adapter), "--gate", "mujoco", "--format", "json", cwd=tmp_path)
    assert done.returncode == ExitCode.FINDINGS, done.stderr
    (gate,) = json.loads(done.stdout)["targets"][0]["gates"]
    found = {result["slug"]: result for result in gate["results"]}
    assert found["evaluation-loop-runs"]["outcome"] == "fail"
    assert "exit code 0" in found["evaluation-loop-runs"]["findings"][0]["message"]
    assert found["closed-loop"]["outcome"] == "pass"


def test_a_checkout_that_one_stands_in_does_not_bring_the_judge(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its envs/mujoco, or a folder of that name, is meant by its path only."""
    ours = environments.find("mujoco")
    for folder in (tmp_path / "envs" / "mujoco", tmp_path / "mujoco"):
        folder.mkdir(parents=True)
        (folder / "env.yml").write_bytes((ours / "env.yml").read_bytes())
    monkeypatch.chdir(tmp_path)
    assert environments.find("mujoco") == ours
    assert "for the one in" in capsys.readouterr().err
    assert environments.find("./envs/mujoco") == tmp_path / "envs" / "mujoco"
    assert environments.find("envs/mujoco") == tmp_path / "envs" / "mujoco"
