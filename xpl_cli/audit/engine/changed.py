"""Which packages changed since a commit, judged by the files that an audit reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl_cli.audit.static.source import Source
from xpl_cli.basics.git.history import Repository

if TYPE_CHECKING:
    from collections.abc import Iterable

    from xpl_cli.packages.targets import Target


def select_changed(ref: str, targets: Iterable[Target]) -> list[Target]:
    """Return the packages with a boundary file that differs from where the working tree left a commit's history.

    That is the merge base of the commit and HEAD: what others changed there meanwhile does not count. Files that are
    not committed, or not even added, do. Of files that are gone nobody can say whether they were read: each counts.

    Args:
        ref: a branch, tag or commit.
        targets: packages.

    Raises:
        UserError: if a package lies in no git repository, if there is no such commit there, or no git.
    """
    return [target for target in targets if _is_changed(ref, target)]


def _is_changed(ref: str, target: Target) -> bool:
    repository = Repository.of(target.path)
    paths = repository.changed(repository.base(ref), target.path)
    names = {path.relative_to(target.path).as_posix() for path in paths}
    present = {name for name in names if (target.path / name).is_file()}
    return bool(names - present) or bool(present.intersection(Source(target.path).files))
