"""Progress of long work: a spinner on a terminal, nothing elsewhere."""

from __future__ import annotations

import contextlib
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@contextlib.contextmanager
def progress(*, lines: bool = True) -> Iterator[Callable[[str], None]]:
    """Yield a function that says what is being done.

    Args:
        lines: without a terminal, whether to print each new message as a plain line.
    """
    if sys.stderr.isatty():
        from rich.console import Console

        console = Console(stderr=True, highlight=False)
        with console.status("") as status:
            yield status.update
        return

    def say(text: str) -> None:
        if lines:
            sys.stderr.write(f"{text}\n")
            sys.stderr.flush()

    yield say
