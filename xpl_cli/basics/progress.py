"""Progress of long work: a live line on a terminal, plain lines elsewhere."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.basics import console
from xpl_cli.basics.untrusted import one_line

if TYPE_CHECKING:
    from collections.abc import Iterator

_Say = Callable[[str], None]


def _nothing(_text: str) -> None:
    pass


@dataclass(frozen=True)
class Progress:
    """Callbacks for progress reports.

    Attributes:
        step: reports the start of a step; without a terminal as a line of its own.
        detail: reports the work inside a step; on a terminal only.
    """

    step: _Say = _nothing
    detail: _Say = _nothing


@contextlib.contextmanager
def progress() -> Iterator[Progress]:
    """Yield callbacks for progress reports on stderr."""
    if not sys.stderr.isatty():
        yield Progress(step=_line)
        return
    from rich.console import Console
    from rich.text import Text

    with Console(stderr=True, highlight=False).status("") as status:

        def show(text: str) -> None:
            status.update(Text(one_line(text)))

        yield Progress(step=show, detail=show)


def _line(text: str) -> None:
    console.note(one_line(text))
