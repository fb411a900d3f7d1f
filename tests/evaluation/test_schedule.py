"""The order of episodes, retries and stopping: exactly one final line for each episode."""

from __future__ import annotations

import itertools
import shutil
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.recordings.runs import synthetic_run
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.records.model import AttemptExecution, EpisodeOutcome
from xpl_cli.evaluation.records.records import RecordError, RecordWriter
from xpl_cli.evaluation.rollout.backend import RolloutJob, RolloutResult, lost_rollout
from xpl_cli.evaluation.runs import runner
from xpl_cli.evaluation.runs.schedule import Schedule

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from xpl_cli.evaluation.records.model import EpisodeRecord, RunPlan

GOOD = EpisodeOutcome(success=True, score=1.0, end_reason="success")
WHEN = AttemptExecution(started="2026-11-21T12:00:00Z", wall_seconds=1.0)


class Killed(Exception):  # noqa: N818 - no error, but what a test does
    """The run ends here."""


class Script:
    """A backend in memory: a function determines the result of each job, and another one their order."""

    def __init__(
        self, workers: int, answer: Callable[[RolloutJob], list[RolloutResult]], turn: Callable[[int], int]
    ) -> None:
        self.workers = workers
        self.answer = answer
        self.turn = turn
        self.playing: list[RolloutJob] = []
        self.played: list[RolloutJob] = []

    def free(self) -> int:
        return self.workers - len(self.playing)

    def submit(self, job: RolloutJob) -> None:
        assert self.free() > 0
        self.playing.append(job)

    def wait(self) -> list[RolloutResult]:
        job = self.playing.pop(self.turn(len(self.playing)))
        self.played.append(job)
        return self.answer(job)

    def close(self) -> None:
        """Do nothing."""


class Silent:
    """A view without output."""

    def add(self, line: EpisodeRecord, left: int) -> None:
        assert left >= 0


def _never(_outcomes: Sequence[bool | None]) -> bool:
    return False


def _good(job: RolloutJob) -> list[RolloutResult]:
    return [RolloutResult(job, GOOD, WHEN, {"processor": "x"})]


def _first(_count: int) -> int:
    return 0


def _play(folder: Path, plan: RunPlan, backend: Script, enough: Any = _never) -> records.Run:
    with RecordWriter(folder, plan) as writer:
        runner.run_schedule(writer, backend, Schedule(writer.run, 0, enough), Silent())
    return records.read(folder)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> RunPlan:
    """Return a plan of two cells with three episodes each, and three attempts."""
    folder = synthetic_run(tmp_path_factory.mktemp("plan"), tasks=["a"], episodes=3, played=0)
    return records.read(folder).plan


def test_episodes_run_in_the_order_of_the_plan(plan: RunPlan, tmp_path: Path) -> None:
    backend = Script(2, _good, _first)
    run = _play(tmp_path, plan, backend)
    assert [job.index for job in backend.played] == [0, 1, 2, 3, 4, 5] == list(run.finals)
    assert {job.attempt for job in backend.played} == {1}


@pytest.mark.parametrize("name", ["traces", "films", records.FILE])
def test_nothing_is_written_through_a_link_of_a_run(name: str, plan: RunPlan, tmp_path: Path) -> None:
    """The folder of a continued run may hold a link of a third party."""
    run, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    RecordWriter(run, plan).close()
    elsewhere.mkdir()
    (elsewhere / "0.npz").write_text("somebody's")
    if name == records.FILE:
        (run / name).rename(elsewhere / name)
        (run / name).symlink_to(elsewhere / name)
    else:
        (run / name).symlink_to(elsewhere)
    before = {path: path.read_bytes() for path in elsewhere.iterdir()}

    def answer(job: RolloutJob) -> list[RolloutResult]:
        return [RolloutResult(job, GOOD, WHEN, {"processor": "x"}, b"curves", b"film")]

    with pytest.raises(RecordError, match=f"{name}.* cannot be written"):
        _play(run, plan, Script(1, answer, _first))
    assert {path: path.read_bytes() for path in elsewhere.iterdir()} == before


def test_a_file_of_a_run_that_is_a_link_is_replaced(plan: RunPlan, tmp_path: Path) -> None:
    """Not what it leads to."""
    RecordWriter(tmp_path, plan).close()
    (tmp_path / "kept").write_text("somebody's")
    (tmp_path / "traces").mkdir()
    (tmp_path / "traces" / "0.npz").symlink_to(tmp_path / "kept")
    _play(
        tmp_path, plan, Script(1, lambda job: [RolloutResult(job, GOOD, WHEN, {"processor": "x"}, b"curves")], _first)
    )
    assert (tmp_path / "kept").read_text() == "somebody's"
    assert (tmp_path / "traces" / "0.npz").read_bytes() == b"curves"


def test_an_infrastructure_error_is_retried_after_others_and_within_a_bound(plan: RunPlan, tmp_path: Path) -> None:
    """An infrastructure error in every attempt is final; attempts are counted from 1."""

    def answer(job: RolloutJob) -> list[RolloutResult]:
        return [lost_rollout(job, "gone")] if job.index == 1 else _good(job)

    backend = Script(1, answer, _first)
    run = _play(tmp_path, plan, backend)
    assert [job.index for job in backend.played] == [0, 1, 2, 1, 3, 1, 4, 5]
    assert [(line.attempt, line.final) for line in run.attempts if line.index == 1] == [
        (1, False), (2, False), (3, True),
    ]  # fmt: skip
    assert (run.finals[1].failure, run.finals[1].success) == ("infrastructure", None)


def test_an_outage_ends_the_run_before_it_eats_the_episodes(plan: RunPlan, tmp_path: Path) -> None:
    """Nothing can run: the run stops, nearly all stays open, and resuming runs it."""
    cells = [replace(cell, seeds=list(range(20))) for cell in plan.cells]
    long = replace(plan, cells=cells).named()
    with pytest.raises(UserError, match="12 attempts in a row") as caught:
        _play(tmp_path, long, Script(3, lambda job: [lost_rollout(job, "gone")], _first))
    assert caught.value.code == ExitCode.NOT_RUN
    assert not records.read(tmp_path).finals
    assert len(_play(tmp_path, long, Script(3, _good, _first)).finals) == 40


def test_many_workers_that_are_lost_at_once_are_no_outage(plan: RunPlan, tmp_path: Path) -> None:
    """Only attempts that began after the last success indicate one."""
    cells = [replace(cell, seeds=list(range(40))) for cell in plan.cells]
    lost_once = Counter[int]()

    def answer(job: RolloutJob) -> list[RolloutResult]:
        if job.index in range(1, 17) and not lost_once[job.index]:
            lost_once[job.index] += 1
            return [lost_rollout(job, "node died")]
        return _good(job)

    run = _play(tmp_path, replace(plan, cells=cells).named(), Script(17, answer, _first))
    assert len(run.finals) == 80
    assert not any(line.failure for line in run.finals.values())


def test_a_backend_may_have_nothing_to_tell(plan: RunPlan, tmp_path: Path) -> None:
    pauses = iter([True, False] * 12)
    backend = Script(2, _good, _first)
    wait = backend.wait
    backend.wait = lambda: [] if next(pauses) else wait()  # type: ignore[method-assign]
    assert len(_play(tmp_path, plan, backend).finals) == 6


def test_a_cell_ends_when_it_is_enough(plan: RunPlan, tmp_path: Path) -> None:
    """By its episodes in the order of the plan, whatever the order in which they end; the other cell goes on."""
    cells = [replace(cell, seeds=list(range(20))) for cell in plan.cells]
    long = replace(plan, cells=cells).named()

    def enough(outcomes: Sequence[bool | None]) -> bool:
        return len(outcomes) >= 5

    turns = itertools.cycle([2, 0, 1])
    for workers, turn in ((1, _first), (4, lambda count: next(turns) % count)):
        folder = tmp_path / str(workers)
        run = _play(folder, long, Script(workers, _good, turn), enough)
        for start in (0, 20):
            assert {start + number for number in range(5)} <= set(run.finals)
            assert len([index for index in run.finals if start <= index < start + 20]) < 5 + 2 * workers
        assert _play(folder, long, Script(1, _good, _first), enough).attempts == run.attempts


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data(), workers=st.integers(1, 4))
def test_whatever_happens_each_episode_is_final_once(
    plan: RunPlan, tmp_path: Path, data: st.DataObject, workers: int
) -> None:
    """Workers die, results come twice or late, the run is killed and resumed: nothing is counted twice or missing."""
    folder = tmp_path / "run"
    shutil.rmtree(folder, ignore_errors=True)
    old: list[RolloutResult] = []

    def answer(job: RolloutJob) -> list[RolloutResult]:
        what = data.draw(st.sampled_from(["good", "good", "lost", "twice", "late", "killed"]))
        if what == "killed":
            raise Killed
        if what == "lost":
            old.extend(_good(job))
            return [lost_rollout(job, "gone")]
        return [*(old if what == "late" else ()), *_good(job), *(_good(job) if what == "twice" else ())]

    for _ in range(200):
        try:
            backend = Script(workers, answer, lambda count: data.draw(st.integers(0, count - 1)))
            run = _play(folder, plan, backend)
            break
        except (Killed, UserError):
            continue
    assert list(run.finals) == [0, 1, 2, 3, 4, 5]
    finals = [line for line in run.attempts if line.final]
    assert len(finals) == 6
    for index in run.finals:
        numbers = [line.attempt for line in run.attempts if line.index == index]
        assert numbers == list(range(1, len(numbers) + 1))
        assert len(numbers) <= plan.control.attempts
