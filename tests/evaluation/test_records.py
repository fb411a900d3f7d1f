"""A run's record: what is written stays, what is torn counts for nothing, what is damaged is refused."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.checkout import ROOT
from tests.support.recordings.runs import synthetic_run
from tests.support.work import calls
from xpl_cli.basics.errors import NotFoundError
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.records.model import EpisodeRecord
from xpl_cli.evaluation.records.records import RecordError, RecordWriter
from xpl_cli.standard.validate import validate

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a run of 8 episodes, of which 5 are completed."""
    return synthetic_run(tmp_path / "run", episodes=2, played=5)


def _lines(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / records.FILE).read_text(encoding="utf-8").splitlines()]


def _write(folder: Path, lines: list[Any]) -> None:
    (folder / records.FILE).write_text("".join(f"{json.dumps(line)}\n" for line in lines), encoding="utf-8")


def _next(folder: Path, index: int = 5) -> EpisodeRecord:
    """Return a final line of an episode that has not run."""
    run = records.read(folder)
    slot = run.plan.slots()[index]
    return replace(run.finals[0], index=index, task=slot.task, setting=slot.setting, seed=slot.seed)


def test_a_record_is_what_its_lines_say(folder: Path) -> None:
    """Plan, machines, attempts in their order, and the final line of every episode that has one."""
    run = records.read(folder)
    lines = _lines(folder)
    assert run.plan.as_json() == lines[0]
    assert run.machines == {lines[1]["machine"]: lines[1]["facts"]}
    assert [EpisodeRecord.parse(line) for line in lines[2:]] == run.attempts
    assert list(run.finals) == [0, 1, 2, 3, 4]
    assert not run.torn
    assert records.read(folder / records.FILE) == run


def test_a_line_that_was_cut_short_anywhere_counts_for_nothing_and_is_written_anew(folder: Path) -> None:
    """Whatever part of the last line is there, the others are as before, and the next writer goes on from them."""
    file = folder / records.FILE
    content = file.read_bytes()
    start = content[:-1].rindex(b"\n") + 1
    whole = records.read(folder)
    for end in [start, start + 1, *range(start + 2, len(content), 97), len(content) - 1]:
        file.write_bytes(content[:end])
        run = records.read(folder)
        assert list(run.finals) == [0, 1, 2, 3]
        assert run.torn == (end > start)
        with RecordWriter(folder, whole.plan) as writer:
            writer.add(whole.finals[4])
        assert json.loads(file.read_bytes().splitlines()[-1]) == whole.finals[4].as_json()
        assert records.read(folder).finals == whole.finals


def test_a_last_line_of_zeros_counts_for_nothing(folder: Path) -> None:
    """What a file system may leave of a line when the power fails."""
    with (folder / records.FILE).open("ab") as stream:
        stream.write(b"\0" * 100 + b"\n")
    assert records.read(folder).torn
    with RecordWriter(folder, records.read(folder).plan) as writer:
        writer.add(_next(folder))
    assert len(records.read(folder).finals) == 6


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda lines: [*lines, lines[-1]], "has a final line already"),
        (lambda lines: [*lines, {**lines[-1], "index": 99}], "no episode 99"),
        (lambda lines: [*lines, {**lines[-1], "index": 5}], "episode 5 of the plan is"),
        (lambda lines: [{**lines[0], "embodiment": "piper"}, *lines[1:]], "it was changed"),
        (lambda lines: lines[1:], "must be the plan"),
    ],
    ids=["twice", "beyond", "other seed", "other plan", "no plan"],
)
def test_a_record_that_contradicts_itself_is_refused(folder: Path, spoil: Any, message: str) -> None:
    _write(folder, spoil(_lines(folder)))
    with pytest.raises(RecordError, match=message):
        records.read(folder)


def test_a_new_record_begins_with_its_plan(folder: Path, tmp_path: Path) -> None:
    plan = records.read(folder).plan
    with pytest.raises(NotFoundError, match="no recorded run"):
        records.read(tmp_path / "new")
    for left in (b"", b'{"kind": "ru'):
        (tmp_path / "new").mkdir(exist_ok=True)
        (tmp_path / "new" / records.FILE).write_bytes(left)
        with pytest.raises(RecordError, match="no first line"):
            records.read(tmp_path / "new")
        RecordWriter(tmp_path / "new", plan).close()
        assert records.read(tmp_path / "new").plan == plan


def test_a_record_has_one_writer_and_one_plan(folder: Path) -> None:
    """Another writer is refused while the first lives, another plan always, and by name of what differs."""
    plan = records.read(folder).plan
    with RecordWriter(folder, plan), pytest.raises(RecordError, match="being written by another process"):
        RecordWriter(folder, plan)
    other = replace(plan, policy=replace(plan.policy, digest="0" * 64), until_width=0.1).named()
    with pytest.raises(RecordError, match=r"policy\.digest, until_width differ"):
        RecordWriter(folder, other)


def test_an_episode_becomes_final_once(folder: Path) -> None:
    """A second line is refused, and nothing is written."""
    before = (folder / records.FILE).read_bytes()
    with (
        RecordWriter(folder, records.read(folder).plan) as writer,
        pytest.raises(RecordError, match="final line already"),
    ):
        writer.add(writer.run.finals[0])
    assert (folder / records.FILE).read_bytes() == before


def test_a_machine_is_written_once(folder: Path) -> None:
    with RecordWriter(folder, records.read(folder).plan) as writer:
        names = {writer.machine({"processor": "a"}) for _ in range(3)}
    assert [line["machine"] for line in _lines(folder) if line["kind"] == "machine"][1:] == [*names]
    assert validate(_lines(folder)[-1], "record") == []


def test_half_a_line_is_taken_back_where_the_disk_is_full(folder: Path) -> None:
    """The next line is complete, and the error names the cause."""
    script = """
        import dataclasses, resource, sys
        from pathlib import Path
        from xpl_cli.evaluation.records import records
        folder = Path(sys.argv[1])
        run = records.read(folder)
        line = dataclasses.replace(run.finals[0], index=5, task="stack_cubes", setting="clean", seed=1)
        with records.RecordWriter(folder, run.plan) as writer:
            size = (folder / records.FILE).stat().st_size
            resource.setrlimit(resource.RLIMIT_FSIZE, (size + 100, resource.RLIM_INFINITY))
            try:
                writer.add(line)
            except records.RecordError as error:
                print(error)
            assert (folder / records.FILE).stat().st_size == size
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            writer.add(line)
    """
    command = [sys.executable, "-c", textwrap.dedent(script), str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "cannot be written: File too large" in done.stdout
    assert list(records.read(folder).finals) == [0, 1, 2, 3, 4, 5]


@pytest.mark.slow
def test_reading_takes_as_much_for_each_episode_however_many_there_are(tmp_path: Path) -> None:
    """And little: 150 calls are 60 us, so that ten thousand episodes are there in less than a second."""
    for episodes in (10, 100):
        folder = synthetic_run(tmp_path / str(episodes), [f"task_{number}" for number in range(10)], episodes=episodes)
        run, count = calls(partial(records.read, folder))
        assert len(run.finals) == 20 * episodes
        assert count < 150 * len(run.finals)
