"""Errors that a user can act on, and the exit codes of every command."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """Exit codes of `xpl`, the same for every command."""

    CLEAN = 0
    FINDINGS = 1
    USAGE = 2
    NOT_FOUND = 3
    NOT_RUN = 4
    INTERNAL = 5
    INTERRUPTED = 130


class UserError(Exception):
    """A mistake of the user, or of the machine, that one sentence explains.

    Args:
        message: what was expected, what came and where.
        hint: what to do about it.
        code: exit code of the command.
    """

    def __init__(self, message: str, *, hint: str | None = None, code: ExitCode = ExitCode.USAGE) -> None:
        super().__init__(message)
        self.hint = hint
        self.code = code


class NotFoundError(UserError):
    """The target of a command does not exist."""

    def __init__(self, message: str, *, hint: str | None = None) -> None:
        super().__init__(message, hint=hint, code=ExitCode.NOT_FOUND)
