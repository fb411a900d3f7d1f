"""The file of `--output`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl_cli.basics.errors import NotFoundError, UserError

if TYPE_CHECKING:
    from pathlib import Path


def check(path: Path) -> None:
    """Check before the work, which may take minutes, that the file can be written.

    Raises:
        UserError: if it is a folder.
        NotFoundError: if its parent folder does not exist.
    """
    if path.is_dir():
        raise UserError(f"--output takes a file, got the folder {path}", hint=f"--output {path / 'answer.json'}")
    if not path.parent.is_dir():
        raise NotFoundError(f"there is no folder {path.parent} for --output {path}", hint=f"mkdir -p {path.parent}")


def write(path: Path, text: str) -> None:
    """Write the file atomically.

    Raises:
        UserError: if it cannot be written.
    """
    from xpl_cli.basics import atomic

    try:
        if path.exists() and not path.is_file():
            _write_through(path, text)  # a pipe or a device cannot be replaced
        else:
            atomic.write_file(path.resolve(), text.encode(errors="replace"))
    except (OSError, RuntimeError) as error:  # RuntimeError for a circular link, before Python 3.13
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"--output {path} cannot be written: {reason}") from error


def _write_through(path: Path, text: str) -> None:
    """Write to a pipe or a device; a pipe without a reader is an error and does not block."""
    import os

    descriptor = os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    os.set_blocking(descriptor, True)
    with os.fdopen(descriptor, "w", encoding="utf-8", errors="replace") as stream:
        stream.write(text)
