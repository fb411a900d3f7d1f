"""The process of a benchmark's launcher: its output goes to stderr, and it ends with the command."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from typing import TYPE_CHECKING

from xpl_cli.basics.errors import ExitCode, UserError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

_STDERR = 2
_END_S = 20.0
_HOUR_S = 3600.0


def run(words: Sequence[str], folder: Path, variables: Mapping[str, str], hours: float) -> int:
    """Run a command and return its exit code, negative for a signal.

    Args:
        words: the command line, without a shell.
        folder: working directory.
        variables: all of its environment variables.
        hours: timeout.

    Raises:
        UserError: it cannot be started, or took too long.
    """
    try:
        process = subprocess.Popen(
            list(words),
            cwd=folder,
            env=dict(variables),
            stdin=subprocess.DEVNULL,
            stdout=_STDERR,
            stderr=_STDERR,
            start_new_session=True,
        )
    except OSError as error:
        raise UserError(f"{words[0]} cannot be started: {error.strerror or error}", code=ExitCode.NOT_RUN) from None
    try:
        return process.wait(hours * _HOUR_S)
    except subprocess.TimeoutExpired:
        raise UserError(f"the launcher has not ended after {hours:g} hours", code=ExitCode.NOT_RUN) from None
    finally:
        _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the process and everything of its group; first in order, then by force."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_END_S)
            if number == signal.SIGTERM and not _group_lives(process.pid):
                return


def _group_lives(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except (ProcessLookupError, PermissionError):
        return False
    return True
