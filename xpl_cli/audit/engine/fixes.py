"""Apply the edits of findings: each fix whole or not at all, and never to a file that changed meanwhile."""

from __future__ import annotations

import ast
import codecs
import difflib
import io
import re
import stat
import tokenize
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

from xpl_cli.audit.engine.engine import audit_all
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.basics.atomic import write_file
from xpl_cli.basics.errors import UserError
from xpl_cli.basics.phrases import count_noun
from xpl_cli.basics.progress import Progress
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from xpl_cli.audit.rules.model import Edit, Fix, TargetReport
    from xpl_cli.audit.rules.options import AuditOptions
    from xpl_cli.packages.targets import AuditTarget

_SAFE: Final = frozenset(("safe_edit",))
_ALL: Final = frozenset(("safe_edit", "unsafe_edit"))
_LINES: Final = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")


class _RefusedError(Exception):
    """A file cannot be edited; the argument says why."""


@dataclass(frozen=True)
class FileChange:
    """One file before and after.

    Attributes:
        path: the file.
        display_path: the path as messages name it.
        before, after: its content.
    """

    path: Path
    display_path: str
    before: bytes
    after: bytes


@dataclass
class FixPlan:
    """The changes that fixes make.

    Attributes:
        changes: the files that change.
        fixes: number of fixes that are applied.
        later: number of fixes that overlap with another one; they can be applied in another run.
        unsafe: number of fixes that were left out because they are unsafe.
        refused: why files were not edited, a sentence for each.
    """

    changes: list[FileChange] = field(default_factory=list)
    fixes: int = 0
    later: int = 0
    unsafe: int = 0
    refused: list[str] = field(default_factory=list)

    def __iadd__(self, other: FixPlan) -> Self:
        self.changes += other.changes
        self.fixes += other.fixes
        self.later += other.later
        self.unsafe += other.unsafe
        self.refused += other.refused
        return self

    def diff(self) -> str:
        """Return the changes as a unified diff for `patch -p1` and `git apply`."""
        return "".join(line for change in self.changes for line in _diff(change))

    def summary(self, *, done: bool) -> str:
        """Return a summary in words: what would change, or what was changed if `done`."""
        number, files = count_noun(self.fixes, "fix", "fixes"), count_noun(len(self.changes), "file")
        lines = [f"{number} {'applied to' if done else 'would change'} {files}"]
        if self.later:
            lines.append(f"{count_noun(self.later, 'fix', 'fixes')} left, because they overlap with others: run again")
        if self.unsafe:
            lines.append(f"{count_noun(self.unsafe, 'unsafe fix', 'unsafe fixes')} left: --unsafe-fixes takes them too")
        return "\n".join([*lines, *self.refused])

    def apply(self) -> None:
        """Write the files, each in one step.

        Raises:
            UserError: if a file changed since it was read, or cannot be written; then none is changed.
        """
        for change in self.changes:
            if not change.path.is_file() or change.path.read_bytes() != change.before:
                raise UserError(
                    f"{change.display_path} changed while it was audited: nothing was fixed", hint="run again"
                )
        done: list[FileChange] = []
        try:
            for change in self.changes:
                write_file(change.path, change.after, stat.S_IMODE(change.path.stat().st_mode))
                done.append(change)
        except OSError as error:
            for written in done:
                write_file(written.path, written.before, stat.S_IMODE(written.path.stat().st_mode))
            raise UserError(
                f"{change.display_path} cannot be written, nothing was fixed: {error.strerror or error}"
            ) from error


def plan_all(targets: Sequence[AuditTarget], options: AuditOptions, *, unsafe: bool = False) -> FixPlan:
    """Return what the fixes of the static gate would do to packages; other gates have none.

    Args:
        targets: the packages.
        options: what to run; without the static gate nothing is fixed.
        unsafe: include fixes that may change correct behaviour.
    """
    result = FixPlan()
    if Gate.STATIC not in options.gates:
        return result
    reports = audit_all(targets, replace(options, gates=(Gate.STATIC,), progress=Progress()))
    for target, report in zip(targets, reports, strict=True):
        result += plan(target.path, report, unsafe=unsafe)
    return result


def plan(folder: Path, report: TargetReport, *, unsafe: bool = False) -> FixPlan:
    """Return what the fixes of a report would do to a package.

    Args:
        folder: the package.
        report: what an audit found.
        unsafe: include fixes that may change correct behaviour.
    """
    fixes = [
        finding.fix
        for result in report.results
        for finding in result.findings
        if finding.fix is not None and finding.fix.edits and finding.fix.kind in _ALL
    ]
    selected = list(dict.fromkeys(fix for fix in fixes if fix.kind in (_ALL if unsafe else _SAFE)))
    result = FixPlan(unsafe=sum(fix.kind not in _SAFE for fix in fixes) if not unsafe else 0)
    documents: dict[str, _Document] = {}
    for name in sorted({edit.path for fix in selected for edit in fix.edits}):
        try:
            documents[name] = _Document.read(folder, name, report.contents.get(name))
        except _RefusedError as why:
            result.refused.append(f"{report.path}/{name} {why}")
    possible = [fix for fix in selected if all(edit.path in documents for edit in fix.edits)]
    chosen = _without_overlaps(possible)
    result.later = len(possible) - len(chosen)
    _compose(result, chosen, documents, report.path)
    return result


def _compose(result: FixPlan, chosen: list[Fix], documents: dict[str, _Document], display_path: str) -> None:
    """Add the changes that fixes make. Where one would break a file, all fixes of that file are left out."""
    for name in sorted({edit.path for fix in chosen for edit in fix.edits}):
        try:
            _apply_edits(name, documents[name], chosen)
        except _RefusedError as why:
            result.refused.append(f"{display_path}/{name} {why}")
            chosen = [fix for fix in chosen if all(edit.path != name for edit in fix.edits)]
    result.fixes = len(chosen)
    for name in sorted({edit.path for fix in chosen for edit in fix.edits}):
        document = documents[name]
        after = _apply_edits(name, document, chosen)
        if after != document.content:
            result.changes.append(FileChange(document.path, f"{display_path}/{name}", document.content, after))


def _apply_edits(name: str, document: _Document, chosen: Iterable[Fix]) -> bytes:
    edits = dict.fromkeys(edit for fix in chosen for edit in fix.edits if edit.path == name)
    text = document.edited(edits)
    if _parses(name, document.text) and not _parses(name, text):
        raise _RefusedError("would not parse after its fixes; that is a fault of a rule")
    return document.encoded(text)


def _without_overlaps(fixes: list[Fix]) -> list[Fix]:
    """Return the fixes that can be carried out together, earlier ones first."""
    chosen: list[Fix] = []
    taken: list[Edit] = []
    for fix in fixes:
        if not any(_overlap(one, other) for one in fix.edits for other in taken if one != other):
            chosen.append(fix)
            taken += fix.edits
    return chosen


def _overlap(one: Edit, other: Edit) -> bool:
    if one.path != other.path:
        return False
    first, second = sorted((_range(one), _range(other)))
    return second[0] < first[1] or second[0] == first[0]


def _range(edit: Edit) -> tuple[tuple[int, int], tuple[int, int]]:
    return (edit.line, edit.column), (edit.end_line, edit.end_column)


@dataclass(frozen=True)
class _Document:
    """A text file that keeps its encoding, byte order mark and line ends.

    Attributes:
        content: its bytes.
        text: its characters, without the mark.
    """

    path: Path
    content: bytes
    text: str
    encoding: str
    mark: bytes

    @classmethod
    def read(cls, folder: Path, name: str, expected: str | None) -> _Document:
        """Read a file of a package.

        Raises:
            _RefusedError: if it is not the file that was audited, or cannot be written back as it was.
        """
        path = folder / name
        if path.is_symlink() or not path.resolve().is_relative_to(folder.resolve()):
            raise _RefusedError("is a link, and what it leads to may belong to others")
        try:
            content = path.read_bytes()
            mark = codecs.BOM_UTF8 if content.startswith(codecs.BOM_UTF8) else b""
            python = name.endswith(".py") and not mark
            encoding = tokenize.detect_encoding(io.BytesIO(content).readline)[0] if python else "utf-8"
            text = content[len(mark) :].decode(encoding)
        except (OSError, SyntaxError, UnicodeDecodeError, LookupError) as error:
            raise _RefusedError(f"cannot be read as text: {error}") from None
        if text.replace("\r\n", "\n").replace("\r", "\n") != expected:
            raise _RefusedError("changed while it was audited; run again")
        return cls(path, content, text, encoding, mark)

    def edited(self, edits: Iterable[Edit]) -> str:
        """Return the text with edits that do not overlap.

        Raises:
            _RefusedError: if an edit is about a place that is not there.
        """
        lines = _LINES.findall(self.text)
        starts = [0, *accumulate(map(len, lines))]
        newline = "\r\n" if "\r\n" in self.text else "\n"

        def offset(line: int, column: int) -> int:
            length = len(lines[line - 1].rstrip("\r\n")) if line <= len(lines) else 0
            if not 1 <= line <= len(starts) or not 1 <= column <= length + 1:
                raise _RefusedError(f"has no line {line}, column {column}; that is a fault of a rule")
            return starts[line - 1] + column - 1

        text = self.text
        for edit in sorted(edits, key=_range, reverse=True):
            start, end = offset(edit.line, edit.column), offset(edit.end_line, edit.end_column)
            text = text[:start] + edit.text.replace("\n", newline) + text[end:]
        return text

    def encoded(self, text: str) -> bytes:
        """Return the bytes of a text in this file's encoding.

        Raises:
            _RefusedError: if the encoding lacks a character.
        """
        try:
            return self.mark + text.encode(self.encoding)
        except UnicodeEncodeError as error:
            raise _RefusedError(f"cannot hold the fix in its encoding: {error}") from None


def _parses(name: str, text: str) -> bool:
    import yaml

    try:
        if name.endswith(".py"):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                ast.parse(text)
        elif name.endswith((".yml", ".yaml")):
            spec.parse_yaml(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError, yaml.YAMLError):
        return False
    return True


def _diff(change: FileChange) -> Iterator[str]:
    before, after = (_lines(content) for content in (change.before, change.after))
    name = change.display_path.removeprefix("/")
    for line in difflib.unified_diff(before, after, f"a/{name}", f"b/{name}"):
        yield line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n"


def _lines(content: bytes) -> list[str]:
    return re.findall(r"[^\n]*\n|[^\n]+", content.decode(errors="replace"))
