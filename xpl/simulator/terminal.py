"""The terminal that an environment's `input()` reads from in a process without a terminal of its own."""

from __future__ import annotations

import contextlib
import io
import os
import sys

TERMINAL = "XPL_TERMINAL"
"""Variable with the name of the main process's terminal, if it has one."""


class NoTerminalError(RuntimeError):
    """An environment waits for a person, and there is no terminal."""


class _NoTerminal(io.StringIO):
    """Standard input without a terminal: reading raises a clear error instead of EOFError."""

    def readline(self, size: int | None = -1, /) -> str:  # type: ignore[override]  # noqa: ARG002 - as there
        """Raise.

        Raises:
            NoTerminalError: always.
        """
        raise NoTerminalError(
            "the environment waits for a person, and this run has no terminal: start it from one, or answer otherwise"
        )

    read = readline


def publish_terminal() -> None:
    """Pass the name of this process's terminal, if it has one, to processes that are started later."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.environ[TERMINAL] = os.ttyname(sys.stdin.fileno())


def use_terminal() -> None:
    """Let `input()` read from the main process's terminal; without one, let it raise `NoTerminalError`."""
    name = os.environ.get(TERMINAL)
    if name:
        with contextlib.suppress(OSError):
            # Not as the controlling terminal: signals of its keys go to the main process.
            descriptor = os.open(name, os.O_RDONLY | os.O_NOCTTY)
            sys.stdin = os.fdopen(descriptor, encoding="utf-8", errors="replace")
            return
    sys.stdin = _NoTerminal()
