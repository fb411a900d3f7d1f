"""Subprocess tasks: a module of the SDK runs in a policy's interpreter, reads a request file and writes an answer file.

They call an adapter, or its reference code, without a server. The module has `main(request, answers)`; the answers are
packed maps (`xpl.wire.packed`), each after its length, that of loading first (`xpl.worker.inprocess`).
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Final, Self

from xpl import _spec as sdk
from xpl.process import spawn
from xpl.process.child import SDK_START
from xpl.wire import packed
from xpl.worker.subprocess_task import ERROR, LENGTH
from xpl_cli.isolation import processes
from xpl_cli.isolation.forks import AdapterForkServer, Forked, run_forked
from xpl_cli.isolation.hang_detector import HangDetector
from xpl_cli.isolation.isolation_settings import IsolationSettings
from xpl_cli.isolation.stacks import STACKS_S, innermost_frame

_EVERY_S: Final = 0.1
_END_S: Final = 10.0
"""Time for the reaper of a forked process to kill all that it started, s."""
_MOST_BYTES: Final = 1 << 30
"""Largest total size of the answers of one task."""


@dataclass(frozen=True)
class TaskSettings:
    """How a task runs.

    Attributes:
        python: the interpreter.
        checkout: its working directory, the adapter's folder.
        bounds: its isolation.
        patience: longest time without activity, s.
        limit_s: longest total time, s.
        on_answer: called with the number of answers whenever it has grown, or None.
        forks: forks the process with the policy's libraries imported, in the same isolation, where that is possible.
    """

    python: str
    checkout: Path
    bounds: IsolationSettings = field(default_factory=IsolationSettings)
    patience: float = 30.0
    limit_s: float = 600.0
    on_answer: Callable[[int], None] | None = None
    forks: AdapterForkServer | None = None


@dataclass(frozen=True)
class TaskAnswer:
    """One answer of a task.

    Attributes:
        result: the result; None for an error.
        error: the error, or None.
        trace: where it was raised, if known.
        unreal: whether only the real model could have answered.
    """

    result: Any = None
    error: str | None = None
    trace: str | None = None
    unreal: bool = False

    @classmethod
    def parse(cls, entry: object) -> Self:
        """Parse an entry that a process wrote, which may be anything."""
        if not isinstance(entry, dict) or not {ERROR, sdk.Payload.RESULT} & entry.keys():
            return cls(error="no answer")
        if ERROR not in entry:
            return cls(entry[sdk.Payload.RESULT])
        trace = entry.get("trace")
        return cls(None, str(entry[ERROR]), None if trace is None else str(trace), bool(entry.get("unreal")))


@dataclass(frozen=True)
class TaskResult:
    """The result of a task.

    Attributes:
        answers: the complete answers.
        problem: why the process was killed, or how it ended without a complete answer; None on success.
        last_line: last line that the process printed.
    """

    answers: list[TaskAnswer]
    problem: str | None
    last_line: str

    @property
    def failure(self) -> str:
        """How the process ended, for missing answers."""
        return self.problem or f"ended without an answer: {self.last_line:.200}"


def run(module: str, request: Mapping[str, object], settings: TaskSettings) -> TaskResult:
    """Run a task to its end.

    Args:
        module: a module of the SDK, such as `xpl.worker.inprocess`.
        request: its input: maps, lists, texts, numbers and arrays.
        settings: how it runs.
    """
    with _workspace(settings) as workspace:
        task = _TaskProcess(module, request, settings, workspace)
        with task.running():
            return task.wait_answers(workspace.folder / "answers", settings.limit_s)


class PersistentTask:
    """A task that loads an adapter once and answers requests (`xpl.worker.subprocess_task`).

    Args:
        module: a module of the SDK.
        request: what it loads.
        settings: how it runs; its limit applies to loading.

    Attributes:
        loaded: result of loading.
    """

    def __init__(self, module: str, request: Mapping[str, object], settings: TaskSettings) -> None:
        self._settings, self._requests = settings, 0
        with contextlib.ExitStack() as opened:
            workspace = opened.enter_context(_workspace(settings))
            self._folder = workspace.folder
            self._run = _TaskProcess(module, request, settings, workspace)
            opened.enter_context(self._run.running(subprocess.PIPE))
            self.loaded = self._run.wait_answers(self._folder / "answers", settings.limit_s)
            self._opened = opened.pop_all()

    def request(self, content: Mapping[str, object], limit_s: float) -> TaskResult:
        """Return the answers to a request; none if the process has ended."""
        self._requests += 1
        (self._folder / f"asked.{self._requests}").write_bytes(b"".join(packed.encode(content)))
        self._run.write_line(f"{self._requests}\n")
        done = self._run.wait_answers(self._folder / f"answers.{self._requests}", limit_s)
        for name in ("asked", "answers"):
            (self._folder / f"{name}.{self._requests}").unlink(missing_ok=True)
        return done

    def close(self) -> None:
        """Kill the process."""
        self._opened.close()


def _read_answers(path: Path) -> list[TaskAnswer]:
    """Return the complete answers in a file.

    Raises:
        PackingError: if one is malformed.
    """
    answers: list[TaskAnswer] = []
    if path.is_file() and path.stat().st_size > _MOST_BYTES:
        raise packed.PackingError(f"its answers take more than {_MOST_BYTES} bytes")
    data = memoryview(path.read_bytes() if path.is_file() else b"")
    while len(data) >= LENGTH.size:
        (length,) = LENGTH.unpack_from(data)
        data = data[LENGTH.size :]
        if length > len(data) or not length:  # length 0 ends the answers of a persistent task
            break
        answers.append(TaskAnswer.parse(packed.decode(data[:length])))
        data = data[length:]
    return answers


@dataclass(frozen=True)
class _Workspace:
    """Command prefix, writable folder and environment variables of a task, as for a server."""

    prefix: tuple[str, ...]
    folder: Path
    environment: dict[str, str]


@contextlib.contextmanager
def _workspace(settings: TaskSettings) -> Iterator[_Workspace]:
    environment = spawn.variables()
    with (
        settings.bounds.isolate_adapter(settings.checkout) as isolation,
        tempfile.TemporaryDirectory(prefix="xpl-") as folder,
    ):
        if isolation is None:
            yield _Workspace((), Path(folder), environment)
        else:
            yield _Workspace(isolation.prefix, isolation.folder or Path(folder), isolation.environment(environment))


def _count_answers(path: Path) -> tuple[int, bool]:
    """Return the number of answers in a file by their lengths, and whether the file is complete."""
    count = offset = 0
    if not path.is_file():
        return 0, False
    with path.open("rb") as stream:
        while len(head := stream.read(LENGTH.size)) == LENGTH.size:
            (length,) = LENGTH.unpack(head)
            offset += LENGTH.size + length
            if not length:
                return count, True
            if offset > _MOST_BYTES:  # a malformed length: the process can write anything
                break
            stream.seek(offset)
            count += 1
    return count, False


class _TaskProcess:
    """The process of a task, in a group of its own; its request is written at once."""

    def __init__(
        self, module: str, request: Mapping[str, object], settings: TaskSettings, workspace: _Workspace
    ) -> None:
        self._module, self._settings, self._workspace = module, settings, workspace
        self._log = workspace.folder / "log"
        self._arguments = [str(workspace.folder / name) for name in ("asked", "answers")]
        Path(self._arguments[0]).write_bytes(b"".join(packed.encode(request)))

    @contextlib.contextmanager
    def running(self, stdin: int = subprocess.DEVNULL) -> Iterator[None]:
        """Start the process; at the end of the block kill it and its descendants."""
        before = {member.pid for member in processes.descendants(os.getpid())}
        processes.adopt_orphans()
        # A file, not a pipe: a leftover process of the adapter would keep a pipe open.
        with self._log.open("wb") as output:
            process = self._forked(output, stdin) or self._started(output, stdin)
        try:
            self._process = process
            yield
        finally:
            if isinstance(process, Forked):
                process.end()
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(_END_S)
            spawn.end_group(process.pid)
            process.wait()
            if process.stdin is not None:
                with contextlib.suppress(OSError):
                    process.stdin.close()
            processes.kill_adopted(before)

    def _started(self, output: IO[bytes], stdin: int) -> subprocess.Popen[bytes]:
        start = SDK_START + f"from {self._module} import main; main(*sys.argv[2:])"
        return subprocess.Popen(
            spawn.command(self._settings.python, start, *self._arguments, prefix=self._workspace.prefix),
            cwd=self._settings.checkout,
            stdin=stdin,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=self._workspace.environment,
            start_new_session=True,
        )

    def _forked(self, output: IO[bytes], stdin: int) -> Forked | None:
        forks = self._settings.forks
        if forks is None or forks.folder is not None:  # a fully isolated one does not see this task's folder
            return None
        return run_forked(forks, self._module, self._arguments, output, stdin)

    def write_line(self, line: str) -> None:
        """Write a line to its standard input, if it still runs."""
        assert self._process.stdin is not None  # noqa: S101 - it was started so
        with contextlib.suppress(OSError):
            self._process.stdin.write(line.encode())
            self._process.stdin.flush()

    def wait_answers(self, path: Path, limit_s: float) -> TaskResult:
        """Return the answers that it writes to a file until the file is complete or the process ends."""
        problem = self._wait(path, limit_s)
        try:
            return TaskResult(_read_answers(path), problem, self.last_line)
        except packed.PackingError as error:
            return TaskResult([], f"wrote a malformed answer: {error}", self.last_line)

    @property
    def last_line(self) -> str:
        """Last line that the process printed."""
        return next((line.strip() for line in reversed(self._lines()) if line.strip()), "it printed nothing")

    def _wait(self, path: Path, limit_s: float) -> str | None:
        """Wait for the answers; return why the process was killed, or None."""
        process, reported = self._process, 0
        began, size, detector = time.monotonic(), -1, None
        while True:
            now = time.monotonic()
            written = path.stat().st_size if path.is_file() else 0
            if detector is None or written != size:  # another answer: detection of hangs starts again
                size, detector = written, HangDetector(process.pid, self._settings.patience, now)
                count, is_all = _count_answers(path)
                if count > reported and self._settings.on_answer is not None:
                    self._settings.on_answer(count)
                reported = count
                if is_all:
                    return None
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(min(detector.every_s, _EVERY_S))
                return None
            why = detector.check(time.monotonic())
            if why is None and written > _MOST_BYTES:
                why = f"wrote answers of more than {_MOST_BYTES} bytes"
            if why is None and time.monotonic() - began > limit_s:
                why = f"did not answer within {time.monotonic() - began:.0f} s"
            if why is not None:
                return self._end_with_stacks(process, why)

    def _end_with_stacks(self, process: subprocess.Popen[bytes] | Forked, why: str) -> str:
        """Have the process print its stacks, and return the reason with its innermost frame."""
        above = 1 if isinstance(process, Forked) else processes.LAUNCHERS if self._settings.bounds.flags else 0
        inner = processes.first_descendants(process.pid, above)[-1]
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.kill(inner, signal.SIGUSR1)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(STACKS_S)
        stood = innermost_frame(self._lines(), self._settings.checkout.resolve())
        return why if stood is None else f"{why}; it stood at {stood}"

    def _lines(self) -> list[str]:
        return self._log.read_text(encoding="utf-8", errors="replace").splitlines() if self._log.is_file() else []
