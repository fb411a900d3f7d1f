"""What the static gate reads at most: beyond these bounds a file is data, or an attack, and no source.

They bound the time and the memory of every rule, because rules walk trees and lists that came through here. A file
beyond a bound is a finding of the rule `parses`; rules that need it are not run.
"""

from __future__ import annotations

import ast
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

MOST_NODES: Final = 250_000
"""Nodes of the syntax tree of one Python file."""
MOST_LEVELS: Final = 200
"""Levels of a syntax tree: what takes more overflows the stack of whoever reads it."""
MOST_PYTHON: Final = 4 << 20
"""Characters of all Python files of a package: their trees take fifty times as much memory, and more."""
MOST_TEXT: Final = 64 << 20
"""Bytes of all files of a package that are read as text."""
LONGEST_S: Final = 120.0
"""Processor time, in seconds, that all rules of the gate may take on one package: a hundred times what they do take."""


class TooMuchError(ValueError):
    """A file is larger or deeper than any that a person wrote; the argument says how."""


class TooLong(BaseException):
    """A rule was not done in time. No rule catches it by mistake: it is no `Exception`."""


def bounded_nodes(tree: ast.Module) -> tuple[ast.AST, ...]:
    """Return the nodes of a syntax tree, the outermost first.

    Raises:
        TooMuchError: if there are too many, or they are nested too deeply.
    """
    nodes: list[ast.AST] = []
    level: list[ast.AST] = [tree]
    depth = 0
    while level:
        nodes += level
        if depth > MOST_LEVELS:
            raise TooMuchError(f"nested more than {MOST_LEVELS} levels deep")
        if len(nodes) > MOST_NODES:
            raise TooMuchError(f"more than {MOST_NODES} nodes of syntax, as only a program writes them")
        level = [child for node in level for child in ast.iter_child_nodes(node)]
        depth += 1
    return tuple(nodes)


@contextmanager
def deadline(seconds: float = LONGEST_S) -> Iterator[None]:
    """End what takes more processor time, where the system can: in the main thread of a POSIX process.

    Args:
        seconds: how much there is; 0 or less ends at once.

    Raises:
        TooLong: in what takes longer.
    """
    if seconds <= 0:
        raise TooLong
    can = hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread()
    if not can or signal.getsignal(signal.SIGVTALRM) is not signal.SIG_DFL:
        yield
        return

    def on_alarm(_number: int, _frame: object) -> None:
        raise TooLong

    signal.signal(signal.SIGVTALRM, on_alarm)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, signal.SIG_DFL)
