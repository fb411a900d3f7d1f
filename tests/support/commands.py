"""The command line in this process, for tests that try it very often."""

from __future__ import annotations

import contextlib
import io
import signal
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from xpl_cli.basics import console
from xpl_cli.main import main

TRACEBACK = "Traceback (most recent call last)"


class Ended(NamedTuple):
    """How a command ended: its exit code, and what it wrote."""

    code: int
    stdout: str
    stderr: str


def xpl(*arguments: str | Path, folder: Path | None = None, limit_s: float = 60.0) -> Ended:
    """Run a command in this process, and return how it ended.

    Args:
        arguments: the command line after `xpl`.
        folder: working directory for it.
        limit_s: after so many seconds it is taken to hang, which fails the test.
    """
    console._output.is_used = False
    environment = io.BytesIO(), io.BytesIO()
    out, err = (io.TextIOWrapper(buffer, encoding="utf-8", errors="strict") for buffer in environment)
    with _in(folder), _limited(limit_s, arguments), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(argument) for argument in arguments])
    for stream in (out, err):
        stream.flush()
    return Ended(int(code), *(buffer.getvalue().decode() for buffer in environment))


def problem(ended: Ended, allowed: Sequence[int] = (0, 1, 2, 3, 4)) -> str | None:
    """Return what is wrong with how a command ended, None if it is one sentence and an exit code that may be."""
    if ended.code not in allowed:
        return f"exit code {ended.code}: {ended.stderr.strip()[-400:]}"
    if TRACEBACK in ended.stderr:
        return f"a traceback: {ended.stderr[-400:]}"
    errors = [line for line in ended.stderr.splitlines() if line.startswith("error: ")]
    if ended.code in (2, 3) and len(errors) != 1:
        return f"exit code {ended.code} with {len(errors)} sentences: {ended.stderr[-400:]!r}"
    return None


@contextlib.contextmanager
def _in(folder: Path | None) -> Iterator[None]:
    if folder is None:
        yield
        return
    with contextlib.chdir(folder):
        yield


@contextlib.contextmanager
def _limited(seconds: float, arguments: Sequence[str | Path]) -> Iterator[None]:
    """Raise in the middle of what takes too long; works in a main thread."""

    def ring(_signal: int, _frame: object) -> None:
        raise AssertionError(f"still running after {seconds:g} s: xpl {' '.join(map(str, arguments))[:300]}")

    before = signal.signal(signal.SIGALRM, ring)
    interrupts = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        for number, handler in interrupts.items():
            signal.signal(number, handler)
