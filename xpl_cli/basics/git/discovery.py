"""Where a repository is: found by looking for `.git` in the folders above, never by asking git.

Git would also take a folder for a repository that holds `HEAD`, `objects` and `refs`; here such a folder is never one.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

from xpl_cli.basics.errors import UserError
from xpl_cli.basics.git.command import Git

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_MARK: Final = ".git"
_POINTER: Final = b"gitdir: "
_LONGEST: Final = 8192


def work_tree(folder: Path) -> Git | None:
    """Return the repository whose work tree holds a folder; None if there is none."""
    return next(_above(folder.resolve()), None)


def of_package(package: Path, here: Path) -> Git | None:
    """Return the repository of a package, or None.

    Args:
        package: its folder.
        here: the working directory.

    Raises:
        UserError: if the package lies in a nested repository and the working directory does not: the package's
            author may have forged the history of the nested one.
    """
    package = package.resolve()
    inner, outer, *_ = (*_above(package), None, None)
    if inner is None:
        return None
    if outer is not None and not here.resolve().is_relative_to(inner.root):
        raise nested(package, inner.root, outer.root)
    for folder in (package, *package.parents):
        if folder == inner.root:
            break
        if _is_bare(folder):
            raise nested(package, folder, inner.root)
    return inner


def nested(package: Path, inner: Path, outer: Path) -> UserError:
    """Return the error for a package in a nested repository."""
    return UserError(
        f"{package} lies in a repository of its own ({inner}) inside the repository {outer}, which cannot tell what "
        "changed there: expected a package among the files of one repository",
        hint="audit it without --changed-since, or from its own repository",
    )


def _above(folder: Path) -> Iterator[Git]:
    """Yield the repositories around a folder, the innermost first."""
    for root in (folder, *folder.parents):
        directory = _directory(root / _MARK)
        if directory is not None:
            yield Git(directory, root)


def _directory(mark: Path) -> Path | None:
    """Return the repository that `.git` is or points to, as in a linked work tree or a submodule."""
    try:
        if mark.is_dir():
            return mark if (mark / "HEAD").exists() else None
        if not mark.is_file():
            return None
        with mark.open("rb") as stream:
            content = stream.read(_LONGEST)
        if not content.startswith(_POINTER):
            return None
        directory = mark.parent / os.fsdecode(content.removeprefix(_POINTER).strip())
        return directory.resolve() if (directory / "HEAD").exists() else None
    except (OSError, ValueError, RuntimeError):
        return None


def _is_bare(folder: Path) -> bool:
    """Tell whether git would take a folder for a bare repository."""
    return all((folder / name).exists() for name in ("HEAD", "objects", "refs"))
