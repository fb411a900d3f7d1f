"""A run's record: one append-only file of lines (`spec/v1.1/record.schema.json`), read strictly and written for good.

    runs/foo/records.jsonl     the plan, machines, and one line for every attempt at an episode
    runs/foo/traces/, films/   what episodes looked like

A line counts once it is on the disk, with its end. Whatever ends the writer costs at most the line that was being
written, which is the last one: it counts for nothing, and the next writer cuts it off.
"""

from __future__ import annotations

import datetime as dt
import fcntl
import json
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from xpl import _spec as sdk
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.evaluation.records.fingerprints import digest_of

if TYPE_CHECKING:
    from collections.abc import Mapping

FILE = "records.jsonl"
SCHEMA = "xpl.record/1"
_NEWLINE = b"\n"

Line = dict[str, Any]
"""A line of the file, as the schema has it."""


class RecordError(UserError):
    """A record that cannot be read, or written."""

    def __init__(self, message: str, *, hint: str | None = None) -> None:
        super().__init__(message, hint=hint, code=ExitCode.NOT_RUN)


@dataclass(frozen=True)
class Slot:
    """The place of one episode in a plan.

    Attributes:
        index: the episode's key.
        cell: number of its cell in the plan.
        task, setting, seed: what is played.
    """

    index: int
    cell: int
    task: str
    setting: str
    seed: int


@dataclass(frozen=True)
class Run:
    """What is known of a run.

    Attributes:
        folder: of the run.
        plan: the first line.
        machines: facts of each, by digest.
        attempts: every line of an episode, in the order in which they came, the final ones too.
        finals: the final line of each episode that has one, by index in ascending order.
        torn: whether the last line was cut short.
    """

    folder: Path
    plan: Line
    machines: dict[str, Line] = field(default_factory=dict)
    attempts: list[Line] = field(default_factory=list)
    finals: dict[int, Line] = field(default_factory=dict)
    torn: bool = False


def slots(plan: Mapping[str, Any]) -> list[Slot]:
    """Return the episodes of a plan, each at its index."""
    seeds = ((number, cell, seed) for number, cell in enumerate(plan["cells"]) for seed in cell["seeds"])
    return [
        Slot(index, number, cell["task"], cell["setting"], seed) for index, (number, cell, seed) in enumerate(seeds)
    ]


def named(plan: Mapping[str, Any]) -> Line:
    """Return the first line of a run that plays a plan: with its name, and the present time."""
    essence = {key: value for key, value in plan.items() if key not in ("run", "created")}
    return {**essence, "run": digest_of(essence), "created": now()}


def now() -> str:
    """Return the time, UTC, as records have it."""
    return dt.datetime.now(dt.UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def read(path: Path) -> Run:
    """Read a run.

    Args:
        path: the run's folder, or its records.jsonl.

    Raises:
        NotFoundError: there is none.
        RecordError: a line is damaged, contradicts the plan, or makes an episode final again.
    """
    file = path if path.name == FILE else path / FILE
    try:
        content = file.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise NotFoundError(f"{path} holds no recorded run: {file} is missing") from None
    except OSError as error:
        raise RecordError(f"{file} cannot be read: {error.strerror or error}") from None
    found = _parse(file, content)[0]
    if found is None:
        raise RecordError(f"{file} has no first line yet: the run was ended before it began")
    return found


class Writer:
    """Adds lines to a run's record; nobody else may write to it meanwhile.

    A record that is there is continued: what a crash cut short is cut off.

    Args:
        folder: of the run; made if it is not there.
        plan: the first line of a new record (`named`); an old one must have been made for the same plan.

    Attributes:
        run: what the record holds.

    Raises:
        RecordError: the record is of another plan, damaged, being written by another process, or cannot be written.
    """

    def __init__(self, folder: Path, plan: Mapping[str, Any]) -> None:
        self._file = folder / FILE
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._descriptor = os.open(self._file, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise RecordError(f"{self._file} cannot be written: {error.strerror or error}") from None
        try:
            self.run = self._begin(folder, plan)
        except BaseException:
            os.close(self._descriptor)
            raise
        self._slots = slots(self.run.plan)

    def machine(self, facts: Mapping[str, Any]) -> str:
        """Return the digest of a machine's facts, which are written once."""
        name = digest_of(facts)
        if name not in self.run.machines:
            self._append({"kind": "machine", "machine": name, "facts": dict(facts)})
            self.run.machines[name] = dict(facts)
        return name

    def add(self, line: Line) -> None:
        """Add one attempt at an episode; it is on the disk when this returns.

        Raises:
            RecordError: it is not of the plan, its episode is final already, or it cannot be written.
        """
        _check(line, self._slots, self.run, str(self._file))
        self._append(line)
        _take(line, self.run)

    def close(self) -> None:
        """Let others write."""
        os.close(self._descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _begin(self, folder: Path, plan: Mapping[str, Any]) -> Run:
        """Lock the file, cut off what is torn, and return what it holds; a new one gets its first line."""
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RecordError(f"{self._file} is being written by another process") from None
        found, whole = _parse(self._file, self._file.read_bytes())
        os.truncate(self._descriptor, whole)
        if found is None:
            self._append(dict(plan))
            _sync_folder(folder)
            return Run(folder, dict(plan))
        if found.plan["run"] != plan["run"]:
            raise RecordError(
                f"{self._file} is of another run: {_differences(found.plan, plan)} differ",
                hint="run the command that began it, or choose another folder with --out",
            )
        return Run(folder, found.plan, found.machines, found.attempts, found.finals)

    def _append(self, line: Line) -> None:
        data = json.dumps(line, separators=(",", ":"), ensure_ascii=False).encode() + _NEWLINE
        before = os.fstat(self._descriptor).st_size
        try:
            while data:
                data = data[os.write(self._descriptor, data) :]
            os.fsync(self._descriptor)
        except OSError as error:
            os.truncate(self._descriptor, before)  # half a line must not stand before others
            raise RecordError(f"{self._file} cannot be written: {error.strerror or error}") from None


def _parse(file: Path, content: bytes) -> tuple[Run | None, int]:
    """Return the run in a file's content, None where not even its first line is whole, and the length that counts.

    Raises:
        RecordError: see `read`.
    """
    *whole, rest = content.split(_NEWLINE)
    torn, length = bool(rest), len(content) - len(rest)
    run: Run | None = None
    places: list[Slot] = []
    for number, raw in enumerate(whole, 1):
        where = f"{file}, line {number}"
        try:
            line = json.loads(raw)
        except ValueError:
            # A machine that loses its power may keep a file's new length without all of its content.
            if number == len(whole) and not rest:
                return (None if run is None else _sorted(run, torn=True)), length - len(raw) - 1
            raise RecordError(f"{where} is damaged: it is not JSON") from None
        try:
            if run is None:
                run = Run(file.parent, _plan(line, where))
                places = slots(run.plan)
            elif line["kind"] == "machine":
                run.machines[line["machine"]] = line["facts"]
            else:
                _check(line, places, run, where)
                _take(line, run)
        except (KeyError, TypeError) as error:
            raise RecordError(f"{where} is no line of {SCHEMA}: {type(error).__name__} {error}") from None
    return (None if run is None else _sorted(run, torn=torn)), length


def _sorted(run: Run, *, torn: bool) -> Run:
    return replace(run, finals=dict(sorted(run.finals.items())), torn=torn)


def _plan(line: Line, where: str) -> Line:
    if line["kind"] != "run" or line["schema"] != SCHEMA:
        raise RecordError(f"{where} must be the plan of a run, of schema {SCHEMA}")
    if line["run"] != named(line)["run"]:
        raise RecordError(f"{where}: the plan is not the one that the run is named after; it was changed")
    return line


def _check(line: Line, places: list[Slot], run: Run, where: str) -> None:
    """Raise a RecordError unless a line is of an episode that may still be played."""
    if line.get("kind") != "episode":
        raise RecordError(f"{where} is neither a machine nor an episode")
    index = line.get("index")
    if not isinstance(index, int) or not 0 <= index < len(places):
        raise RecordError(f"{where}: there is no episode {index} in the plan, which has {len(places)}")
    slot = places[index]
    told, planned = (line["task"], line["setting"], line[sdk.Deploy.SEED]), (slot.task, slot.setting, slot.seed)
    if told != planned:
        raise RecordError(f"{where}: episode {index} of the plan is {planned}, got {told}")
    if index in run.finals:
        raise RecordError(f"{where}: episode {index} has a final line already")


def _take(line: Line, run: Run) -> None:
    run.attempts.append(line)
    if line["final"]:
        run.finals[line["index"]] = line


def _differences(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Return the names of what differs between two plans, one level into those that are maps."""
    found = []
    for key in sorted((one.keys() | other.keys()) - {"run", "created"}):
        a, b = one.get(key), other.get(key)
        if a != b and isinstance(a, dict) and isinstance(b, dict):
            found += [f"{key}.{name}" for name in sorted(a.keys() | b.keys()) if a.get(name) != b.get(name)]
        elif a != b:
            found.append(key)
    return ", ".join(found)


def _sync_folder(folder: Path) -> None:
    """Make sure that a new file's name survives a loss of power, too."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
