"""What no option of any command takes: said once here, so that no command has to think of it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import typer

_MOST_TEXT: Final = 1 << 16
_MOST_PATH, _MOST_NAME = 4095, 255
"""Bytes of a path, and of a name in it, that the system takes."""
_MOST_INTEGER: Final = 2**63 - 1
_SHOWN: Final = 60


def text(value: Any) -> str:
    """Return a text that may be a name, a path or a setting.

    Raises:
        BadParameter: it holds NUL, or is longer than any of them.
    """
    given = str(value)
    if "\0" in given:
        raise typer.BadParameter(f"expected a text, got {quote_value(given)}, which holds NUL")
    if len(given) > _MOST_TEXT:
        raise typer.BadParameter(f"expected at most {_MOST_TEXT} characters, got {len(given)}")
    return given


def path(value: Any) -> Path:
    """Return a path that may be one; whether anything lies there is the command's to say.

    Raises:
        BadParameter: it is empty, holds NUL, is longer than the system bears, or leads in a circle.
    """
    given = text(value)
    if not given:
        raise typer.BadParameter("expected a path, got an empty text; the folder where you are is .")
    found = Path(given)
    if len(given.encode(errors="surrogateescape")) > _MOST_PATH or any(map(_is_too_long, found.parts)):
        raise typer.BadParameter(f"no path is as long as {quote_value(given)}, of {len(given)} characters")
    try:
        found.resolve()
    except (OSError, RuntimeError):
        raise typer.BadParameter(f"{quote_value(given)} is a link that leads back to itself") from None
    return found


def folder(value: Path | None) -> Path | None:
    """Return a folder that is there, for options that need one.

    Raises:
        NotFoundError: there is none.
    """
    from xpl_cli.basics.errors import NotFoundError

    if value is not None and not value.is_dir():
        raise NotFoundError(f"there is no folder {value}")
    return value


def written_on(value: Path | None) -> Path | None:
    """Return a file that lines are added to, or a pipe that somebody reads.

    Raises:
        UserError: nobody reads the pipe; whoever opened it would wait.
    """
    import os

    from xpl_cli.basics.errors import ExitCode, UserError

    if value is not None and value.is_fifo():
        try:
            os.close(os.open(value, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC))
        except OSError:
            raise UserError(f"nobody reads the pipe {value}", code=ExitCode.NOT_RUN) from None
    return value


def certificates(value: Path | None) -> Path | None:
    """Return a file of keys or certificates, which TLS opens by its name and waits for if it is a pipe.

    Raises:
        NotFoundError: there is none.
        UserError: it cannot be read, or is no file.
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
    """Return the address of a policy server.

    Raises:
        BadParameter: it is none.
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
    """Return a number that can be reckoned with.

    Raises:
        BadParameter: it is infinite, no number at all, or beyond 64 bits.
    """
    if isinstance(value, float) and not math.isfinite(value):
        raise typer.BadParameter(f"expected a finite number, got {value}")
    if isinstance(value, int) and abs(value) > _MOST_INTEGER:
        raise typer.BadParameter(f"expected a number of at most 64 bits, got {quote_value(str(value))}")
    return value


def quote_value(given: str) -> str:
    """Return a value as a sentence shows it."""
    return repr(given) if len(given) <= _SHOWN else f"{given[:_SHOWN]!r}..."


def _is_too_long(name: str) -> bool:
    return len(name.encode(errors="surrogateescape")) > _MOST_NAME
