"""Where reports go: stdout, files, or both."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

from xpl_cli import console
from xpl_cli.audit.formats import FORMATS, Context, check_format, for_people, render
from xpl_cli.errors import NotFoundError, UserError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.audit.model import TargetReport


@dataclass(frozen=True)
class Delivery:
    """What is printed and what is written.

    Attributes:
        printed: format on stdout; None for none.
        files: format and path of each file.
    """

    printed: str | None
    files: tuple[tuple[str, Path], ...] = ()

    @classmethod
    def asked(cls, wanted: str, outputs: Sequence[str]) -> Self:
        """Read `--format` and `--output`, before an audit that may take minutes.

        Args:
            wanted: the format.
            outputs: `FILE` takes the report instead of stdout; `FORMAT=FILE` takes it in another format besides.

        Raises:
            UserError: if there is no such format, or a file cannot be written there.
        """
        printed: str | None = check_format(wanted)
        files = []
        for output in outputs:
            name, found, rest = output.partition("=")
            other = name if found and name in FORMATS else None
            path = Path(rest if other else output)
            _check(path)
            files.append((other or wanted, path))
            printed = printed if other else None
        return cls(printed, tuple(files))

    def deliver(self, reports: Sequence[TargetReport], context: Context) -> None:
        """Write the files, each whole or not at all, and print.

        Raises:
            UserError: if a file cannot be written.
        """
        for name, path in self.files:
            _write(path, render(name, reports, context))
            console.note(f"wrote {path}")
        if self.printed == "human":
            console.data(for_people(reports, context, sys.stdout))
        elif self.printed is not None and (text := render(self.printed, reports, context)):
            console.data(text)


def _check(path: Path) -> None:
    if path.is_dir():
        raise UserError(f"--output takes a file, got the folder {path}", hint=f"--output {path / 'audit.json'}")
    if not path.parent.is_dir():
        raise NotFoundError(f"there is no folder {path.parent} for --output {path}", hint=f"mkdir -p {path.parent}")


def _write(path: Path, text: str) -> None:
    from xpl_cli import atomic

    try:
        if path.exists() and not path.is_file():
            path.write_text(text, encoding="utf-8")  # a pipe or a device cannot be replaced
        else:
            atomic.write_file(path.resolve(), text.encode())
    except OSError as error:
        raise UserError(f"--output {path} cannot be written: {error.strerror or error}") from error
