"""What the standard claims, measured: how much an author writes in model.py, how far deploy.py is from the reference.

Files are parsed, never imported or executed.
"""

from __future__ import annotations

import ast
import io
import shlex
import tokenize
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl_cli import __version__
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.audit.static.loops import distance as loop_distance
from xpl_cli.audit.static.source import Source
from xpl_cli.basics.errors import NotFoundError
from xpl_cli.packages import package
from xpl_cli.packages.targets import find_all, find_target, unique
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from xpl_cli.audit.static.loops.distance import LoopDistance
    from xpl_cli.packages.targets import Target

SCHEMA: Final = "xpl.metrics/1"

_UNSEEN: Final = frozenset(
    (
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENCODING,
        tokenize.ENDMARKER,
    )
)
_MOST_ROWS: Final = 40
_STATISTICS: Final = ("min", "median", "p90", "max")


@dataclass(frozen=True)
class Metrics:
    """One adapter, measured.

    Attributes:
        name: the folder's name.
        path: the folder as it was shown.
        ecosystem: whether it follows the field's layout, without a policy.yml.
        lines: lines of code of model.py; None if it cannot be read as Python.
        reached: the same with the adapter's own files that model.py imports.
        loop: the evaluation functions beside the reference; None if deploy.py cannot be read as Python.
        reasons: why something could not be measured.
    """

    name: str
    path: str
    ecosystem: bool
    lines: int | None
    reached: int | None
    loop: tuple[LoopDistance, ...] | None
    reasons: tuple[str, ...] = ()

    @property
    def distance(self) -> float | None:
        """Distance of the loop to the reference, from 0 to 1."""
        return None if self.loop is None else loop_distance.total(self.loop)


@dataclass(frozen=True)
class Distribution:
    """Order statistics; between two values of the sample they are interpolated linearly."""

    count: int
    min: float
    median: float
    p90: float
    max: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Distribution | None:
        """Return the distribution of a sample, None of an empty one."""
        ordered = sorted(values)
        if not ordered:
            return None
        return cls(len(ordered), ordered[0], _quantile(ordered, 0.5), _quantile(ordered, 0.9), ordered[-1])


def policies(paths: Sequence[Path] | None) -> list[Target]:
    """Return the policies at the paths, each once; without paths, all below `policy/` of the working directory.

    Raises:
        NotFoundError: if there is none, or a path leads to an environment.
    """
    if paths is None:
        found = [target for target in find_all() if target.kind == package.POLICY]
        if not found:
            raise NotFoundError(
                f"there is no policy below policy/ of {Path.cwd()}",
                hint="`xpl metrics PATH` measures the policy at PATH",
            )
        return found
    found = [find_target(path) for path in paths]
    for path, target in zip(paths, found, strict=True):
        if target.kind != package.POLICY:
            raise NotFoundError(f"{path} is an environment: metrics are those of policies")
    return unique(found)


def measure(target: Target) -> Metrics:
    """Measure an adapter; what cannot be measured is None, with a reason."""
    source = Source(target.path)
    reasons: list[str] = []
    lines = reached = loop = None
    try:
        lines = code_lines(source, sdk.File.MODEL_PY)
        others = source.reached(sdk.File.MODEL_PY)[1:]
        reached = lines + sum(code_lines(source, name) for name in others if source.parses(name))
    except NotRun as error:
        reasons.append(str(error))
    try:
        loop = tuple(loop_distance.measure(source))
    except NotRun as error:
        reasons.append(str(error))
    return Metrics(target.path.name, target.shown, source.is_ecosystem, lines, reached, loop, tuple(reasons))


def code_lines(source: Source, name: str) -> int:
    """Return how many lines of a Python file hold code: no blank lines, no comments, no docstrings.

    A statement over three lines counts three; other strings count as code, their blank lines do not.

    Raises:
        NotRun: if the file is missing, too large or does not parse.
    """
    text = source.text(name)
    documented = [entry for node in source.nodes(name) if (entry := _docstring(node)) is not None]
    written = text.split("\n")
    counted: set[int] = set()
    try:
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            first, last = token.start[0], token.end[0]
            is_docstring = token.type == tokenize.STRING and any(
                entry.lineno <= first and last <= (entry.end_lineno or first) for entry in documented
            )
            if token.type not in _UNSEEN and not is_docstring:
                counted.update(line for line in range(first, last + 1) if written[line - 1].strip())
    except (tokenize.TokenError, SyntaxError) as error:
        raise NotRun(f"{name} cannot be cut into tokens: {error}") from None
    return len(counted)


def document(measured: Sequence[Metrics]) -> dict[str, Any]:
    """Return `xpl.metrics/1`."""
    lines, distances = distributions(measured)
    return {
        "schema": SCHEMA,
        "tool": {"name": "xpl", "version": __version__},
        "spec": spec.CURRENT,
        "adapters": [_entry(one) for one in measured],
        "distribution": {"model_lines": _numbers(lines), "loop_distance": _numbers(distances)},
        "next": following(measured),
    }


def distributions(measured: Sequence[Metrics]) -> tuple[Distribution | None, Distribution | None]:
    """Return the distributions of the lines of model.py and of the distances of the loops."""
    lines = Distribution.of(one.lines for one in measured if one.lines is not None)
    return lines, Distribution.of(one.distance for one in measured if one.distance is not None)


def following(measured: Sequence[Metrics]) -> list[str]:
    """Return the commands worth running next: audits of what could not be measured, and of the farthest loop."""
    farthest = max(measured, key=lambda one: one.distance or 0.0)
    chosen = dict.fromkeys(one.path for one in [*measured, farthest] if one.reasons or one is farthest)
    return [f"xpl audit --gate static {shlex.quote(path)}" for path in chosen]


def text(measured: Sequence[Metrics]) -> str:
    """Return the report for people: the largest model.py first, the distribution, and what to run next."""
    ordered = sorted(measured, key=lambda one: (-(one.lines or 0), one.name))
    rows: list[tuple[str, ...]] = [("adapter", sdk.File.MODEL_PY, "with its imports", "loop distance")]
    rows += [
        (printable(one.name), *map(_shown, (one.lines, one.reached, one.distance))) for one in ordered[:_MOST_ROWS]
    ]
    if len(measured) > 1:
        lines, distances = distributions(measured)
        rows.append(("", "", "", ""))
        for key in _STATISTICS:
            number = None if lines is None else round(getattr(lines, key))
            rows.append((key, _shown(number), "", _shown(getattr(distances, key, None))))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    said = [
        f"{name:<{widths[0]}}" + "".join(f"{cell:>{width + 2}}" for cell, width in zip(cells, widths[1:], strict=True))
        for name, *cells in rows
    ]
    if len(ordered) > _MOST_ROWS:
        said.append(f"{len(ordered) - _MOST_ROWS} with less are not shown; --json lists all")
    said += [f"{printable(one.name)}: {printable(reason)}" for one in ordered for reason in one.reasons]
    said.append("Lines of code: no blank lines, comments, docstrings. Distance: 0 is the reference, 1 shares nothing.")
    said.append(f"Next: {printable(following(measured)[0])}")
    return "\n".join(line.rstrip() for line in said)


def printable(given: str) -> str:
    """Return a text of somebody else's without what moves a cursor or breaks a document."""
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in given)


def _docstring(node: ast.AST) -> ast.stmt | None:
    if not isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) or not node.body:
        return None
    first = node.body[0]
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str):
        return first
    return None


def _quantile(ordered: Sequence[float], share: float) -> float:
    place = share * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (place - below) * (ordered[above] - ordered[below])


def _entry(one: Metrics) -> dict[str, Any]:
    functions = [
        {
            "name": entry.function,
            "form": entry.form,
            "distance": round(entry.distance, 4),
            "unmatched": entry.unmatched,
            "nodes": entry.nodes,
        }
        for entry in one.loop or ()
    ]
    return {
        "name": one.name,
        "path": one.path,
        "layout": "ecosystem" if one.ecosystem else "xpl",
        "model_lines": one.lines,
        "model_lines_with_imports": one.reached,
        "loop_distance": None if one.distance is None else round(one.distance, 4),
        "loop_functions": functions,
        "reasons": list(one.reasons),
    }


def _numbers(distribution: Distribution | None) -> dict[str, float] | None:
    if distribution is None:
        return None
    return {"count": distribution.count} | {key: round(getattr(distribution, key), 4) for key in _STATISTICS}


def _shown(value: float | None) -> str:
    if value is None:
        return "?"
    return str(value) if isinstance(value, int) else f"{value:.2f}"
