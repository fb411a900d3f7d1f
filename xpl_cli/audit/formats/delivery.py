"""Where reports go: stdout, files, or both."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

from xpl_cli.audit.formats import Context, check_format, for_people, names, render
from xpl_cli.basics import console
from xpl_cli.basics import output as output_file

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.audit.rules.model import TargetReport


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
        files, known = [], names()
        for output in outputs:
            name, found, rest = output.partition("=")
            other = name if found and name in known else None
            path = Path(rest if other else output)
            output_file.check(path)
            files.append((other or wanted, path))
            printed = printed if other else None
        return cls(printed, tuple(files))

    def deliver(self, reports: Sequence[TargetReport], context: Context) -> None:
        """Write the files, each whole or not at all, and print.

        Raises:
            UserError: if a file cannot be written.
        """
        for name, path in self.files:
            output_file.write(path, render(name, reports, context))
            console.note(f"wrote {path}")
        if self.printed == "text":
            console.painted(for_people(reports, context, sys.stdout))
        elif self.printed is not None and (text := render(self.printed, reports, context)):
            console.data(text)
