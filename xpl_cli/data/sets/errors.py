"""What goes wrong with demonstrations."""

from __future__ import annotations

from xpl_cli.basics.errors import ExitCode, UserError


class DataError(UserError, ValueError):
    """Demonstrations, or a part of them, cannot be read or written; the text says what, where and what to do.

    Commands need not catch it: it ends them with its sentence, and with the exit code of what could not run.
    """

    def __init__(self, message: str, *, hint: str | None = None, code: ExitCode = ExitCode.NOT_RUN) -> None:
        super().__init__(message, hint=hint, code=code)


class LibraryMissingError(DataError):
    """What reads a format is not installed here."""
