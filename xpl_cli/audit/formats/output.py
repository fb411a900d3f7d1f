"""Output of reports: stdout, files, or both."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

from xpl_cli.audit.formats import ReportContext, check_format, for_people, names, render
from xpl_cli.basics import console
from xpl_cli.basics import output as output_file

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.audit.rules.model import TargetReport


@dataclass(frozen=True)
class ReportOutput:
    """Formats and files of a report.

    Attributes:
        printed: format on stdout; None for none.
        files: format and path of each file.
    """

    printed: str | None
    files: tuple[tuple[str, Path], ...] = ()

    @classmethod
    def parse(cls, report_format: str, outputs: Sequence[str]) -> Self:
        """Parse `--format` and `--output`, before an audit that may take minutes.

        Args:
            report_format: the format.
            outputs: `FILE` gets the report instead of stdout; `FORMAT=FILE` additionally gets it in another format.

        Raises:
            UserError: if there is no such format, or a file cannot be written there.
        """
        printed: str | None = check_format(report_format)
        files, format_names = [], names()
        for output in outputs:
            name, separator, rest = output.partition("=")
            other = name if separator and name in format_names else None
            path = Path(rest if other else output)
            output_file.check(path)
            files.append((other or report_format, path))
            printed = printed if other else None
        return cls(printed, tuple(files))

    def deliver(self, reports: Sequence[TargetReport], context: ReportContext) -> None:
        """Write the files, each whole or not at all, and print.

        Raises:
            UserError: if a file cannot be written.
        """
        for name, path in self.files:
            output_file.write(path, render(name, reports, context))
            console.note(f"wrote {path}")
        if self.printed == "text":
            console.data_with_colours(for_people(reports, context, sys.stdout))
        elif self.printed is not None and (text := render(self.printed, reports, context)):
            console.data(text)
