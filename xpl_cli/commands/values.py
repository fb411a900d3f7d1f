"""Validation of option values, shared by all commands."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import typer

_MOST_TEXT: Final = 1 << 16
_MOST_PATH, _MOST_NAME = 4095, 255
"""Longest path, and longest name in it, bytes."""
_MOST_INTEGER: Final = 2**63 - 1
_SHOWN: Final = 60


def text(value: Any) -> str:
    """Validate a text.

    Raises:
        BadParameter: if it holds NUL, or is too long.
    """
    value_text = str(value)
    if "\0" in value_text:
        raise typer.BadParameter(f"expected a text, got {quote_value(value_text)}, which holds NUL")
    if len(value_text) > _MOST_TEXT:
        raise typer.BadParameter(f"expected at most {_MOST_TEXT} characters, got {len(value_text)}")
    return value_text


def path(value: Any) -> Path:
    """Validate a path, which need not exist.

    Raises:
        BadParameter: if it is empty, holds NUL, is too long, or is a circular link.
    """
    value_text = text(value)
    if not value_text:
        raise typer.BadParameter("expected a path, got an empty text; the working directory is .")
    result = Path(value_text)
    if len(value_text.encode(errors="surrogateescape")) > _MOST_PATH or any(map(_is_too_long, result.parts)):
        raise typer.BadParameter(f"no path is as long as {quote_value(value_text)}, of {len(value_text)} characters")
    try:
        result.resolve()
    except (OSError, RuntimeError):
        raise typer.BadParameter(f"{quote_value(value_text)} is a circular link") from None
    return result


def folder(value: Path | None) -> Path | None:
    """Validate an existing folder.

    Raises:
        NotFoundError: if there is none.
    """
    from xpl_cli.basics.errors import NotFoundError

    if value is not None and not value.is_dir():
        raise NotFoundError(f"there is no folder {value}")
    return value


def written_on(value: Path | None) -> Path | None:
    """Validate a file for appending, or a pipe with a reader.

    Raises:
        UserError: if the pipe has no reader: opening it would block.
    """
    import os

    from xpl_cli.basics.errors import ExitCode, UserError

    if value is not None and value.is_fifo():
        try:
            os.close(os.open(value, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC))
        except OSError:
            raise UserError(f"the pipe {value} has no reader", code=ExitCode.NOT_RUN) from None
    return value


def certificates(value: Path | None) -> Path | None:
    """Validate a regular file of keys or certificates; TLS would block on a pipe.

    Raises:
        NotFoundError: if there is none.
        UserError: if it cannot be read, or is no file.
    """
    from xpl_cli.basics import files
    from xpl_cli.basics.errors import NotFoundError, UserError

    if value is None:
        return None
    try:
        files.open_regular(value).close()
    except FileNotFoundError:
        raise NotFoundError(f"there is no file {value}") from None
    except OSError as error:
        raise UserError(f"{value} cannot be read: {error.strerror}") from None
    return value


def address(value: str | None) -> str | None:
    """Validate the address of a policy server.

    Raises:
        BadParameter: if it is malformed.
    """
    from urllib.parse import urlsplit

    if value is None:
        return None
    try:
        parts = urlsplit(value)
        host, scheme = parts.hostname if parts.port != 0 else None, parts.scheme.rpartition("+")[2]
    except ValueError:  # an IPv6 address without an end, a port that is none
        host = scheme = None
    if not host or scheme not in ("ws", "wss"):
        raise typer.BadParameter(f"expected ws://HOST:PORT or wss://HOST:PORT, got {quote_value(value)}")
    return value


def number(value: Any) -> Any:
    """Validate a number.

    Raises:
        BadParameter: if it is infinite, NaN, or beyond 64 bits.
    """
    if isinstance(value, float) and not math.isfinite(value):
        raise typer.BadParameter(f"expected a finite number, got {value}")
    if isinstance(value, int) and abs(value) > _MOST_INTEGER:
        raise typer.BadParameter(f"expected a number of at most 64 bits, got {quote_value(str(value))}")
    return value


def quote_value(value: str) -> str:
    """Return a value, quoted and shortened, for messages."""
    return repr(value) if len(value) <= _SHOWN else f"{value[:_SHOWN]!r}..."


def _is_too_long(name: str) -> bool:
    return len(name.encode(errors="surrogateescape")) > _MOST_NAME
