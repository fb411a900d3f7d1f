"""`xpl eval --out`: runs that are executed, recorded, interrupted and resumed, by real processes."""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import uuid
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support import commands
from tests.support.adapters import drill
from tests.support.checkout import ROOT
from tests.support.peer import MARK, processes, wait_until, xpl
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.rollout.backend import BackendConfig
from xpl_cli.evaluation.runs import evaluate, plan
from xpl_cli.evaluation.statistics import summary
from xpl_cli.isolation.isolation_settings import IsolationSettings
from xpl_cli.packages import package
from xpl_cli.standard.validate import validate

if TYPE_CHECKING:
    from xpl_cli.evaluation.records.model import PlannedCell

UNSTEADY = ("started", "wall_seconds", "inference", "server", "worker", "machine", "trace", "film")
"""The parts of a line that depend on time and place of an episode."""


OPTIONS = ("--task", "all", "--episodes", "4", "--horizon", "2", "--json")


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """Return a folder with a run of two tasks by two workers, and the finished command."""
    folder = tmp_path_factory.mktemp("room")
    drill.environment(folder)
    drill.adapter(folder)
    return folder, _eval(folder, *OPTIONS, "--workers", "2", "--film", "1")


@pytest.fixture
def room(tmp_path: Path) -> Path:
    drill.environment(tmp_path)
    drill.adapter(tmp_path)
    return tmp_path


def _eval(room: Path, *options: str) -> subprocess.CompletedProcess[str]:
    return xpl("eval", "Drilled", "--env", "drill", "--out", "run", *options, cwd=room)


def _outcomes(run: records.Run) -> list[dict[str, Any]]:
    """Return what has to be equal for equal plans."""
    return [{key: value for key, value in vars(line).items() if key not in UNSTEADY} for line in run.finals.values()]


def _table(run: records.Run) -> str:
    """Return the final table, as JSON text."""
    report = summary.summarise(run).as_json()
    return json.dumps({key: value for key, value in report.items() if key != "execution"})


def test_a_suite_is_recorded_and_does_not_depend_on_how_many_play_it(
    played: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    """Every line is valid, files have their digests, and two workers give the results of one, with equal traces."""
    room, done = played
    assert done.returncode == ExitCode.CLEAN, done.stderr
    answer = json.loads(done.stdout)
    assert answer["overall"]["successes"] == 6
    assert "8 of 8 episodes" in done.stderr
    lines = [json.loads(line) for line in (room / "run" / records.FILE).read_text().splitlines()]
    assert [problem for line in lines for problem in validate(line, "record")] == []
    run = records.read(room / "run")
    assert [(line.task, line.seed) for line in run.finals.values()] == [
        (task, seed) for task in ("hold", "wait") for seed in range(4)
    ]
    assert [line.success for line in run.finals.values()] == [seed in drill.WINS for seed in range(4)] * 2
    assert [line.failure for line in run.finals.values()] == [None, None, "task", None] * 2
    assert len({line.worker for line in run.finals.values()}) == 2
    assert {line.containment for line in run.finals.values()} == {IsolationSettings.strictest(ROOT, isolate=False).name}
    assert [index for index, line in run.finals.items() if line.film] == [0, 4]
    for line in run.finals.values():
        for file in filter(None, (line.trace, line.film)):
            assert hashlib.sha256((room / "run" / file.path).read_bytes()).hexdigest() == file.digest
        assert line.inference.count == sum(line.inference.histogram) == 3
    alone = xpl("eval", "Drilled", "--env", "drill", "--out", "alone", *OPTIONS, cwd=room)
    assert alone.returncode == ExitCode.CLEAN, alone.stderr
    other = records.read(room / "alone")
    assert _outcomes(other) == _outcomes(run)
    assert _table(other) == _table(run)
    assert [line.trace.digest for line in other.finals.values()] == [line.trace.digest for line in run.finals.values()]
    with np.load(room / "run" / "traces" / "0.npz", allow_pickle=False) as trace:
        curves = dict(trace)
    assert (curves["frequency"], curves["chunk_starts"].tolist()) == (25, [0, 2, 4])
    commanded, observed = curves["action.arm_joint_state"], curves["state.arm_joint_state"]
    assert (commanded.shape, observed.shape) == ((drill.STEPS, 7), (len(curves["state_steps"]), 7))
    assert {value.dtype for name, value in curves.items() if "." in name} == {np.dtype(np.float32)}
    np.testing.assert_array_equal(observed[1:], commanded[curves["state_steps"][1:] - 1])  # it goes where it is told


@pytest.mark.slow
def test_failures_are_attributed_and_infrastructure_errors_are_retried(tmp_path: Path) -> None:
    """A policy that raises fails its episode; a crashed one is restarted; infrastructure errors count as failed."""
    folder = drill.environment(tmp_path, tasks=("hold",))
    drill.adapter(tmp_path, raises=[1])
    drill.mark(folder, "env-dies-3", 1)
    drill.mark(folder, "env-dies-4", 9)
    drill.mark(tmp_path, "policy-dies-0", 1)
    drill.mark(folder, "blind", 99)  # no film, and no harm
    done = _eval(tmp_path, "--episodes", "6", "--horizon", "2", "--film", "6", "--json")
    assert done.returncode == ExitCode.NOT_RUN, done.stderr
    assert "1 of 6 episodes ended with an infrastructure error" in done.stderr
    run = records.read(tmp_path / "run")
    assert [problem for line in run.attempts for problem in validate(line.as_json(), "record")] == []
    finals = run.finals
    assert [finals[index].failure for index in range(6)] == [None, "policy", "task", None, "infrastructure", "task"]
    assert [finals[index].attempt for index in range(6)] == [2, 1, 1, 2, 3, 1]
    assert (finals[1].success, finals[1].end_reason) == (False, "policy_error")
    assert "no idea what to do about 1" in finals[1].error
    assert (finals[4].success, finals[4].score) == (None, None)
    assert "SIGKILL" in finals[4].error
    errors = [line for line in run.attempts if line.failure == "infrastructure"]
    assert [line.index for line in errors].count(0) == 0
    (died,) = (line for line in run.attempts if line.end_reason == "policy_died")
    assert (died.index, died.failure, died.success, died.final) == (0, "policy", False, False)
    assert not any(line.film for line in run.attempts)
    overall = summary.summarise(run).overall
    assert (overall.successes, overall.judged) == (2, 5)
    assert overall.success_rate == pytest.approx(
        1 / 6
    )  # one is an infrastructure error, and one succeeded after its policy had crashed


@pytest.mark.slow
def test_a_run_that_is_there_is_only_continued_if_asked_and_by_the_same_plan(
    played: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    """What is recorded is not overwritten; other episodes are another run, and so is an adapter that changed."""
    room, _ = played
    before = (room / "run" / records.FILE).read_bytes()
    again = _eval(room, "--episodes", "1")
    assert (again.returncode, "--resume" in again.stderr) == (ExitCode.USAGE, True)
    silent = _eval(room, "--resume", "--json")
    assert (silent.returncode, json.loads(silent.stdout)["overall"]["completed"]) == (ExitCode.CLEAN, 8)
    other = _request(room, plan.PlanRequest(episodes=2))
    with pytest.raises(UserError, match=r"cells, control\.horizon differ"):
        evaluate.evaluate(other)
    with (room / "policy" / "Drilled" / "model.py").open("a") as stream:
        stream.write("# changed\n")
    with pytest.raises(UserError, match=r"policy\.digest differ"):
        evaluate.evaluate(_request(room, None))
    assert (room / "run" / records.FILE).read_bytes() == before


def _request(folder: Path, plan_request: plan.PlanRequest | None, **more: Any) -> evaluate.EvalRequest:
    adapter = package.load(folder / "policy" / "Drilled")
    return evaluate.EvalRequest(
        adapter, str(folder / "envs" / "drill"), folder / "run", plan_request, resume=True, **more
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"plan_request": plan.PlanRequest(tasks="hold,fold")}, "no task 'fold'"),
        ({"plan_request": plan.PlanRequest(tasks="hold,hold")}, "twice"),
        ({"plan_request": plan.PlanRequest(), "backend_config": BackendConfig("cloud")}, "local, ray"),
        ({"plan_request": plan.PlanRequest(), "overrides": {"env_cfg_type": "piper_single"}}, "has no piper_single"),
    ],
)
def test_an_invalid_request_is_refused_before_anything_is_recorded(
    room: Path, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UserError, match=message):
        evaluate.evaluate(_request(room, **options))
    assert not (room / "run").exists()


@pytest.mark.parametrize("options", [["--until-width", "0.2"], ["--out", "run", "--workers", "0"], ["--resume"]])
def test_options_that_do_not_go_together_are_refused(room: Path, options: list[str]) -> None:
    done = commands.xpl("eval", "Drilled", "--env", "drill", *options, folder=room)
    assert (done.code, done.stdout, commands.problem(done)) == (ExitCode.USAGE, "", None)
    assert options[-2 if len(options) > 1 else 0] in done.stderr


def test_a_policy_that_does_not_fit_ends_the_run_before_its_first_episode(room: Path) -> None:
    (room / "policy" / "Drilled" / "policy.yml").write_text(json.dumps({"control_frequency": 50}))
    done = _eval(room)
    assert (done.returncode, "50 Hz" in done.stderr) == (ExitCode.USAGE, True)
    assert not records.read(room / "run").attempts


def test_evaluation_seeds_are_those_of_the_environment_where_it_has_some(room: Path) -> None:
    seeds = room / "envs" / "drill" / "seeds"
    seeds.mkdir()
    (seeds / "hold.json").write_text(json.dumps({"clean": [70, 71, 72, 73]}))
    adapter = package.load(room / "policy" / "Drilled")

    def cell(**plan_request: Any) -> PlannedCell:
        made = plan.make_plan(adapter, seeds.parent, adapter.config(), plan.PlanRequest(**plan_request))
        return made.plan.cells[0]

    assert (cell(first=2, episodes=2).seeds, cell(first=2, episodes=2).frozen) == ([72, 73], True)
    assert cell(until_width=0.2).seeds == [70, 71, 72, 73]
    with pytest.raises(UserError, match="has 4 evaluation seeds"):
        cell(first=3, episodes=2)


# -- kills -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_run_that_is_killed_again_and_again_ends_with_the_same_table(room: Path) -> None:
    """No process survives a kill; each episode is final once, and table and traces are those of an uninterrupted run.

    A moment is a random time after a random number of reported episodes, so that busy machines get as far as quick
    ones; the first moments are before the first episode. XPL_KILLS is the number of kills.
    """
    kills = int(os.environ.get("XPL_KILLS", "5"))
    command = [sys.executable, "-m", "xpl_cli", "eval", "Drilled", "--env", "drill", "--task", "all", "--horizon", "2"]
    command += ["--episodes", str(3 + kills), "--workers", "2", "--out"]
    draw, mark = random.Random(20261121), uuid.uuid4().hex  # noqa: S311 - moments, not secrets

    def going_on() -> list[str]:
        return [*command, "killed", *(["--resume"] if (room / "killed" / records.FILE).exists() else [])]

    for _ in range(kills):
        with subprocess.Popen(
            going_on(), cwd=room, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, env={**os.environ, MARK: mark}
        ) as process:
            assert process.stderr is not None
            for _ in range(draw.randrange(4)):
                process.stderr.readline()
            try:
                process.wait(draw.uniform(0.0, 0.2))
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
        wait_until(lambda: not processes(mark), "nothing is left of the run")
    for words in (going_on(), [*command, "whole"]):
        done = subprocess.run(words, cwd=room, capture_output=True, text=True, check=False)
        assert done.returncode == ExitCode.CLEAN, done.stderr
    killed, whole = records.read(room / "killed"), records.read(room / "whole")
    assert killed.plan.run == whole.plan.run
    assert sorted(line.index for line in killed.attempts if line.final) == list(whole.finals)
    assert _outcomes(killed) == _outcomes(whole)
    assert _table(killed).encode() == _table(whole).encode()
    for index in killed.finals:
        one, other = ((run.folder / f"traces/{index}.npz").read_bytes() for run in (killed, whole))
        assert one == other


def _lanes(mark: str) -> list[int]:
    return [pid for pid, line in processes(mark).items() if "rollout.worker_process" in line]


def _servers(mark: str) -> list[int]:
    """Return the servers: they are forked from a process of the same command line."""
    pids = [pid for pid, line in processes(mark).items() if "fork_server" in line]
    parents = {pid: int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1]) for pid in pids}
    return [pid for pid in pids if parents[pid] in pids]


@pytest.mark.slow
def test_killed_workers_and_servers_are_replaced(tmp_path: Path) -> None:
    """Two workers share a server: one of the workers is killed, then the server; their attempts are retried."""
    drill.environment(tmp_path)
    drill.adapter(tmp_path, close_timeout_s=1)
    mark = uuid.uuid4().hex
    command = [sys.executable, "-m", "xpl_cli", "eval", "Drilled", "--env", "drill", "--out", "run", "--film", "0"]
    command += ["--episodes", "60", "--workers", "2", "--servers", "1"]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env={**os.environ, MARK: mark}
    ) as process:
        assert process.stderr is not None
        for victims in (_lanes, _servers):
            while b" episodes, " not in process.stderr.readline():
                assert process.poll() is None
            os.kill(victims(mark)[0], signal.SIGKILL)
        _, stderr = process.communicate()
    assert process.returncode == ExitCode.CLEAN, stderr.decode()
    run = records.read(tmp_path / "run")
    assert [line.success for line in run.finals.values()] == [seed % 3 != 2 for seed in range(60)]
    errors = [line.error for line in run.attempts if line.failure == "infrastructure"]
    assert any("was ended by signal SIGKILL" in error for error in errors)
    assert 2 <= len(errors) <= 4
    assert not processes(mark)


@pytest.mark.slow
def test_a_lane_whose_server_does_not_start_any_more_leaves_its_episodes_to_others(tmp_path: Path) -> None:
    """It costs the attempt in which the server was lost, and no other; without workers the run ends, to be resumed."""
    drill.environment(tmp_path)
    drill.adapter(tmp_path)
    drill.mark(tmp_path, "policy-dies-for-good", 1)
    done = _eval(tmp_path, "--episodes", "20", "--workers", "2")
    assert done.returncode == ExitCode.CLEAN, done.stderr
    run = records.read(tmp_path / "run")
    # Who ends its own process is not spared the episode.
    assert [line.failure for line in run.attempts if line.failure not in {None, "task"}] == ["policy"]
    assert [line.success for line in run.finals.values()] == [seed % 3 != 2 for seed in range(20)]
    drill.mark(tmp_path, "policy-dies-for-good", 1)
    alone = xpl("eval", "Drilled", "--env", "drill", "--out", "alone", "--episodes", "2", cwd=tmp_path)
    assert (alone.returncode, "the weights are gone" in alone.stderr) == (ExitCode.NOT_RUN, True)
    assert not records.read(tmp_path / "alone").finals
