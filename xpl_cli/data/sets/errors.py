"""Errors of datasets."""

from __future__ import annotations

from xpl_cli.basics.errors import ExitCode, UserError


class DataError(UserError, ValueError):
    """A dataset, or a part of one, cannot be read or written; the message says what, where and what to do.

    Commands need not catch it: the command line prints it and exits with its code.
    """

    def __init__(self, message: str, *, hint: str | None = None, code: ExitCode = ExitCode.NOT_RUN) -> None:
        super().__init__(message, hint=hint, code=code)


class LibraryMissingError(DataError):
    """The library that reads a format is not installed."""
