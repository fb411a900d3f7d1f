"""The changes of a branch: packages added, changed or removed, and files outside packages."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl_cli.basics.git.discovery import nested
from xpl_cli.basics.git.history import Repository
from xpl_cli.packages import package
from xpl_cli.packages.targets import find_target, is_package, package_of

if TYPE_CHECKING:
    from xpl_cli.packages.targets import AuditTarget

ADDED: Final = "added"
CHANGED: Final = "changed"

_DOCUMENTS: Final = frozenset((".md", ".rst"))
_NOTICES: Final = frozenset(("LICENSE", "NOTICE"))

_MANIFESTS = frozenset((sdk.File.POLICY_YML, f"{package.ENV}.yml"))


@dataclass(frozen=True)
class ChangedPackage:
    """A package that a branch changes.

    Attributes:
        target: the audit target.
        path: its folder, relative to the repository's root.
        files: number of changed files.
        change: `added` or `changed`.
        documents_only: whether only documents changed, and neither code nor configuration.
    """

    target: AuditTarget
    path: str
    files: int
    change: str
    documents_only: bool = False


@dataclass(frozen=True)
class BranchChange:
    """The difference between a commit and the work tree.

    Attributes:
        ref: name of the commit.
        base: the merge base.
        packages: to audit, ordered by path.
        removed: paths of removed packages.
        elsewhere: changed files outside packages, relative to the repository's root.
    """

    ref: str
    base: str
    packages: tuple[ChangedPackage, ...]
    removed: tuple[str, ...]
    elsewhere: tuple[str, ...]


def change_since(ref: str, repository: Repository) -> BranchChange:
    """Return the changes of the work tree since its merge base with a commit.

    Args:
        ref: a branch, tag or commit.
        repository: the work tree.

    Raises:
        UserError: the commit does not exist, or a package is a nested repository.
    """
    base = repository.base(ref)
    files_by_folder: dict[Path, list[Path]] = {}
    removed, elsewhere = set(), []
    for path in sorted(repository.changed(base)):
        folder = package_of(path)
        if is_package(path):
            raise nested(path, path, repository.root)
        if folder is not None and folder.is_relative_to(repository.root):
            files_by_folder.setdefault(folder, []).append(path)
            continue
        name = path.relative_to(repository.root)
        elsewhere.append(name.as_posix())
        if name.name in _MANIFESTS and not path.is_file():
            removed.add(name.parent.as_posix())
    inside = tuple(name for name in elsewhere if not any(name.startswith(f"{package}/") for package in removed))
    for folder in files_by_folder:
        Repository.of_package(folder, Path.cwd())
    packages = tuple(_touched(folder, files_by_folder[folder], base, repository) for folder in sorted(files_by_folder))
    return BranchChange(ref, base, packages, tuple(sorted(removed)), inside)


def _touched(folder: Path, files: list[Path], base: str, repository: Repository) -> ChangedPackage:
    package_path = folder.relative_to(repository.root).as_posix()
    was_there = repository.has(base, package_path)
    documents_only = was_there and all(path.suffix in _DOCUMENTS or path.name in _NOTICES for path in files)
    change = CHANGED if was_there else ADDED
    return ChangedPackage(find_target(folder), package_path, len(files), change, documents_only)
