"""Lines of a package that were written by hand: neither in the scaffold nor in the task's files."""

from __future__ import annotations

import ast
import io
import tokenize
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from benchmarks.skills_bench.cases import Task

_UNSEEN = frozenset(
    (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
)
SUFFIXES = frozenset({".py", ".yml", ".md", ".sh"})


def written_lines(task: Task, folder: Path) -> int:
    """Return the lines of text in a project's packages that were written by hand.

    A line counts as often as it occurs more often than in the scaffold of its package and in the files of the task
    together; blank lines do not count. So a file of the task that is copied beside model.py costs nothing.
    """
    given_lines = Counter(_lines(task.files))
    return sum(_written(package, given_lines) for package in sorted(folder.glob("*/*/")) if _is_package(package))


def model_lines(folder: Path) -> int | None:
    """Return the lines of code of all model.py with the adapter's own files that they import; None if there are none.

    Files that are no Python are left out.
    """
    from xpl_cli.audit.static.source import Source

    sources = [Source(path.parent) for path in sorted(folder.glob("policy/*/model.py"))]
    counted = [
        code_lines(source.text(name))
        for source in sources
        for name in source.reached("model.py")
        if source.parses(name)
    ]
    return sum(counted) if counted else None


def code_lines(text: str) -> int:
    """Return how many lines of Python hold code: no blank lines, no comments, no docstrings.

    A statement over three lines counts three; other strings count as code, their blank lines do not.
    """
    documented = [entry for node in ast.walk(ast.parse(text)) if (entry := _docstring(node)) is not None]
    written = text.split("\n")
    counted: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        first, last = token.start[0], token.end[0]
        is_docstring = token.type == tokenize.STRING and any(
            entry.lineno <= first and last <= (entry.end_lineno or first) for entry in documented
        )
        if token.type not in _UNSEEN and not is_docstring:
            counted.update(line for line in range(first, last + 1) if written[line - 1].strip())
    return len(counted)


def _docstring(node: ast.AST) -> ast.stmt | None:
    if not isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) or not node.body:
        return None
    first = node.body[0]
    is_text = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    return first if is_text and isinstance(first.value.value, str) else None


def _is_package(folder: Path) -> bool:
    return folder.parent.name in {"policy", "envs"}


def _written(package: Path, given_lines: Counter[str]) -> int:
    scaffolded = Counter(line for text in _scaffold(package) for line in _of(text))
    present = Counter(_lines(package))
    return sum((present - scaffolded - given_lines).values())


def _scaffold(package: Path) -> Iterable[str]:
    """Return the files that the scaffold of a package wrote; none if it was not scaffolded."""
    from xpl_cli.basics.errors import UserError
    from xpl_cli.scaffold import lock

    try:
        files = lock.read_rendered(package)
    except UserError:
        files = {}
    return [content.decode() for name, content in files.items() if Path(name).suffix in SUFFIXES]


def _lines(folder: Path) -> list[str]:
    files = [path for path in sorted(folder.rglob("*")) if path.suffix in SUFFIXES and ".xpl" not in path.parts]
    return [line for path in files for line in _of(path.read_text(encoding="utf-8", errors="replace"))]


def _of(text: str) -> list[str]:
    return [line.strip() for line in text.splitlines() if line.strip()]
