"""What a branch changes: packages that came, changed or went, and files that belong to none."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl_cli.basics.git.history import Repository
from xpl_cli.basics.git.place import nested
from xpl_cli.packages import package
from xpl_cli.packages.targets import find_target, holding, is_package

if TYPE_CHECKING:
    from xpl_cli.packages.targets import Target

ADDED: Final = "added"
CHANGED: Final = "changed"

_DOCUMENTS: Final = frozenset((".md", ".rst"))
_NOTICES: Final = frozenset(("LICENSE", "NOTICE"))

_MANIFESTS = frozenset((sdk.File.POLICY_YML, f"{package.ENV}.yml"))


@dataclass(frozen=True)
class Touched:
    """A package that a change touches.

    Attributes:
        target: what is audited.
        place: its folder from the top of the repository.
        files: how many of its files differ.
        change: `added` or `changed`.
        documents_only: whether no file differs that may run or configure.
    """

    target: Target
    place: str
    files: int
    change: str
    documents_only: bool = False


@dataclass(frozen=True)
class Change:
    """The difference between a commit and the work tree.

    Attributes:
        ref: what the commit was called.
        base: the commit where the two parted.
        packages: what there is to audit, by place.
        removed: places of packages that are gone.
        elsewhere: files of no package, from the top of the repository.
    """

    ref: str
    base: str
    packages: tuple[Touched, ...]
    removed: tuple[str, ...]
    elsewhere: tuple[str, ...]


def change_since(ref: str, repository: Repository) -> Change:
    """Return what the work tree changes since it left a commit's history.

    Args:
        ref: a branch, tag or commit.
        repository: the work tree.

    Raises:
        UserError: if there is no such commit, or a package is a repository of its own inside this one.
    """
    base = repository.base(ref)
    held: dict[Path, list[Path]] = {}
    removed, elsewhere = set(), []
    for path in sorted(repository.changed(base)):
        folder = holding(path)
        if is_package(path):
            raise nested(path, path, repository.root)
        if folder is not None and folder.is_relative_to(repository.root):
            held.setdefault(folder, []).append(path)
            continue
        name = path.relative_to(repository.root)
        elsewhere.append(name.as_posix())
        if name.name in _MANIFESTS and not path.is_file():
            removed.add(name.parent.as_posix())
    inside = tuple(name for name in elsewhere if not any(name.startswith(f"{place}/") for place in removed))
    for folder in held:
        Repository.of_package(folder, Path.cwd())
    packages = tuple(_touched(folder, held[folder], base, repository) for folder in sorted(held))
    return Change(ref, base, packages, tuple(sorted(removed)), inside)


def _touched(folder: Path, files: list[Path], base: str, repository: Repository) -> Touched:
    place = folder.relative_to(repository.root).as_posix()
    was_there = repository.has(base, place)
    documents_only = was_there and all(path.suffix in _DOCUMENTS or path.name in _NOTICES for path in files)
    change = CHANGED if was_there else ADDED
    return Touched(find_target(folder), place, len(files), change, documents_only)
