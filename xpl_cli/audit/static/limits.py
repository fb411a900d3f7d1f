"""Limits of the static gate: a file beyond them is data, or an attack, and no source code.

They bound the time and the memory of every rule, because rules walk only trees and lists within them. A file beyond a
limit is a finding of the rule `parses`; rules that need it are not run.
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
"""Levels of a syntax tree: deeper ones overflow the stack of a reader."""
MOST_PYTHON: Final = 4 << 20
"""Characters of all Python files of a package: their trees take fifty times as much memory, and more."""
MOST_TEXT: Final = 64 << 20
"""Bytes of all files of a package that are read as text."""
LONGEST_S: Final = 120.0
"""Processor time of all rules of the gate on one package, s: a hundred times the usual time."""


class TooMuchError(ValueError):
    """A file is larger or deeper than any source code; the argument says how."""


class TooLong(BaseException):
    """A rule exceeded the time limit. It is no `Exception`, so that no rule catches it by mistake."""


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
    """Limit the processor time of a block, in the main thread of a POSIX process.

    Args:
        seconds: the limit; 0 or less raises at once.

    Raises:
        TooLong: in a block that takes longer.
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
