"""How much of a package was written by hand: lines that neither the scaffold nor the task gave."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from benchmarks.skills_bench.cases import Task

SUFFIXES = frozenset({".py", ".yml", ".md", ".sh"})


def written_lines(task: Task, folder: Path) -> int:
    """Return the lines of text in a project's packages that were written by hand.

    A line counts as often as it stands there more often than in the scaffold of its package and in the files of the
    task together; blank lines do not count. So a file of the task that is copied beside model.py costs nothing.
    """
    given = Counter(_lines(task.files))
    return sum(_written(package, given) for package in sorted(folder.glob("*/*/")) if _is_package(package))


def model_lines(folder: Path) -> int | None:
    """Return the lines of code of all model.py with the files that they import, as `xpl metrics` counts them."""
    from xpl_cli.audit.metrics import measure
    from xpl_cli.packages.targets import find_target

    policies = sorted(path.parent for path in folder.glob("policy/*/model.py"))
    counted = [measure.measure(find_target(path)).reached for path in policies]
    known = [lines for lines in counted if lines is not None]
    return sum(known) if known else None


def _is_package(folder: Path) -> bool:
    return folder.parent.name in {"policy", "envs"}


def _written(package: Path, given: Counter[str]) -> int:
    scaffolded = Counter(line for text in _scaffold(package) for line in _of(text))
    present = Counter(_lines(package))
    return sum((present - scaffolded - given).values())


def _scaffold(package: Path) -> Iterable[str]:
    """Return the files that the scaffold of a package wrote; none if it was not scaffolded."""
    from xpl_cli.basics.errors import UserError
    from xpl_cli.scaffold import adapter, lock

    try:
        kept = lock.read(package)
        files = adapter.render(adapter.recorded(kept), kept.template) if kept else {}
    except UserError:
        files = {}
    return [content.decode() for name, content in files.items() if Path(name).suffix in SUFFIXES]


def _lines(folder: Path) -> list[str]:
    files = [path for path in sorted(folder.rglob("*")) if path.suffix in SUFFIXES and ".xpl" not in path.parts]
    return [line for path in files for line in _of(path.read_text(encoding="utf-8", errors="replace"))]


def _of(text: str) -> list[str]:
    return [line.strip() for line in text.splitlines() if line.strip()]
