"""Which packages changed since a commit, judged by the files that an audit reads or runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from xpl_cli.audit.static.source import Source
from xpl_cli.basics.git.history import Repository

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from xpl_cli.packages.targets import AuditTarget


def select_changed(ref: str, targets: Iterable[AuditTarget], *, is_run: bool = False) -> list[AuditTarget]:
    """Return the packages with a file that differs from the merge base of a commit and HEAD.

    Later changes on the other branch do not count. Files that are not committed, or not even added, do. A deleted file
    always counts, since it may have been read.

    Args:
        ref: a branch, tag or commit.
        targets: packages.
        is_run: whether the audit runs them, so that each of their files counts; else those of the boundary, which it
            reads.

    Raises:
        UserError: if a package is in no git repository, or in a nested one, or if the commit or git does not exist.
    """
    here, targets = Path.cwd(), list(targets)
    by_repository: dict[Repository, list[AuditTarget]] = {}
    for target in targets:
        by_repository.setdefault(Repository.of_package(target.path, here), []).append(target)
    changed = {
        target
        for repository, inside in by_repository.items()
        for target in _changed_in(repository, ref, inside, is_run=is_run)
    }
    return [target for target in targets if target in changed]


def _changed_in(repository: Repository, ref: str, targets: list[AuditTarget], *, is_run: bool) -> Iterator[AuditTarget]:
    paths = repository.changed(repository.base(ref), [target.path for target in targets])
    for target in targets:
        names = {path.relative_to(target.path).as_posix() for path in paths if path.is_relative_to(target.path)}
        present = {name for name in names if (target.path / name).is_file()}
        if names - present or (is_run and names) or present.intersection(Source(target.path).files):
            yield target
