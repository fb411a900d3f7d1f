"""Runs an adapter in a process of its interpreter without server and client, to compare the served one with."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xpl
from xpl.process.child import SDK_START
from xpl.wire import packed
from xpl.worker.inprocess import LENGTH
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.audit.served.hanging import where
from xpl_cli.isolation import family
from xpl_cli.isolation.life import Life
from xpl_cli.lifecycle import interpreter
from xpl_cli.serving.workers.pool import STACKS_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl_cli.audit.rules.options import Options
    from xpl_cli.audit.served.probe import Probe

_EVERY_S = 0.1
LIMIT_S = 600.0
"""Longest run: as long as a server may take to load the model."""

Call = tuple[str, tuple[Any, ...]]
"""A method and its arguments."""


def answers(probe: Probe, script: Sequence[Call], *, watch: bool = False) -> list[dict[str, Any]]:
    """Return what an adapter answers to a script of calls in one process; each is a map of a `result` or an `error`.

    Args:
        probe: the adapter.
        script: the calls.
        watch: note what the model does to its observations; the script may ask for the notes (`xpl.worker.watch`).

    Raises:
        NotRun: if the adapter cannot be loaded there, or the process ends or hangs.
    """
    package, options, choice = probe.package, probe.options, probe.choice
    python = interpreter.resolve(package.path, package.manifest, python=options.python, env=options.env or choice.env)
    order = {
        "policy_dir": str(package.path),
        "config": probe.config,
        "manifest": package.manifest,
        "script": [[method, list(arguments)] for method, arguments in script],
        "watch": watch,
        **choice.stand_in.message,
    }
    with _place(package.path, options) as (prefix, folder, environment):
        asked, told = folder / "script", folder / "answers"
        asked.write_bytes(b"".join(packed.encode(order)))
        start = SDK_START + "from xpl.worker.inprocess import main; main(*sys.argv[2:])"
        command = [*prefix, python, "-c", start, str(Path(xpl.__file__).parent), str(asked), str(told)]
        run = _Run(command, package.path, environment, folder / "log", told)
        why = run.wait(options)
        found = _read(told)
    loaded, answered = (found[0] if found else None), found[1:]
    if loaded is not None and "error" in loaded:
        raise NotRun(f"the model could not be loaded without the server: {loaded['error']}")
    if why is not None or len(answered) < len(script):
        at = "loading" if loaded is None else f"call {len(answered) + 1}, {script[len(answered)][0]}"
        raise NotRun(f"the adapter's process {why or run.ended} ({at})")
    unreal = next((answer["error"] for answer in answered if answer.get("unreal")), None)
    if unreal is not None:
        raise NotRun(unreal)
    return answered


def _read(told: Path) -> list[dict[str, Any]]:
    """Return the answers that are complete, that of the load first."""
    found: list[dict[str, Any]] = []
    data = memoryview(told.read_bytes() if told.is_file() else b"")
    while len(data) >= LENGTH.size:
        (length,) = LENGTH.unpack_from(data)
        data = data[LENGTH.size :]
        if length > len(data):
            break
        try:
            answer = packed.decode(data[:length])
        except packed.PackingError as error:
            raise NotRun(f"the adapter's process wrote what is no answer: {error}") from None
        found.append(answer if isinstance(answer, dict) else {"error": "no answer"})
        data = data[length:]
    return found


@contextlib.contextmanager
def _place(checkout: Path, options: Options) -> Iterator[tuple[tuple[str, ...], Path, dict[str, str]]]:
    """Yield what is put before a command, a folder that it may write to, and its environment; as a server has them."""
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    environment.pop("PYTHONHOME", None)
    with (
        options.bounds.around(checkout) as kept,
        tempfile.TemporaryDirectory(prefix="xpl-") as own,
    ):
        if kept is None:
            yield (), Path(own), environment
        else:
            yield kept.prefix, kept.folder or Path(own), kept.environment(environment)


class _Run:
    """A command in a group of its own."""

    def __init__(self, command: list[str], cwd: Path, environment: dict[str, str], log: Path, told: Path) -> None:
        self._command, self._cwd, self._environment, self._log, self._told = command, cwd, environment, log, told
        self._code = 0

    def wait(self, options: Options) -> str | None:
        """Run it, end all that it started, and return why it was ended before it ended itself, or None."""
        before = {member.pid for member in family.descendants(os.getpid())}
        family.adopt_orphans()
        # A file, not a pipe: a process that the adapter leaves behind would keep a pipe open.
        with self._log.open("wb") as output:
            process = subprocess.Popen(
                self._command,
                cwd=self._cwd,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=self._environment,
                start_new_session=True,
            )
        try:
            return self._waited(process, options)
        finally:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            self._code = process.wait()
            family.end_adopted(before)

    @property
    def ended(self) -> str:
        """How it ended, with the last line that it printed."""
        lines = self._log_lines()
        last = next((line.strip() for line in reversed(lines) if line.strip()), "it printed nothing")
        return f"ended without an answer: {last:.200}"

    def _waited(self, process: subprocess.Popen[bytes], options: Options) -> str | None:
        began, size, life = time.monotonic(), -1, None
        while True:
            now = time.monotonic()
            written = self._told.stat().st_size if self._told.is_file() else 0
            if life is None or written != size:  # another answer: patience begins anew
                size, life = written, Life(process.pid, options.patience, now)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(min(life.every_s, _EVERY_S))
                return None
            why = life.look(time.monotonic())
            if why is None and time.monotonic() - began > min(LIMIT_S, options.clock.left):
                why = f"did not answer within {time.monotonic() - began:.0f} s"
            if why is not None:
                return self._where(process, options, why)

    def _where(self, process: subprocess.Popen[bytes], options: Options, why: str) -> str:
        """Have the process print its stacks, and return why it is ended and where it stood."""
        inner = family.behind_launcher(process.pid)[-1] if options.bounds.flags else process.pid
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.kill(inner, signal.SIGUSR1)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(STACKS_S)
        place = where(self._log_lines(), self._cwd.resolve())
        return why if place is None else f"{why}; it stood at {place}"

    def _log_lines(self) -> list[str]:
        return self._log.read_text(encoding="utf-8", errors="replace").splitlines() if self._log.is_file() else []
