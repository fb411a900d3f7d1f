"""What an audit looks at: policy and environment packages."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from xpl_cli import package
from xpl_cli.errors import NotFoundError


@dataclass(frozen=True)
class Target:
    """One package to audit.

    Attributes:
        path: its folder, absolute.
        kind: `policy` or `env`.
        shown: the folder relative to the working directory where it lies below it, for reports.
    """

    path: Path
    kind: str
    shown: str


def find_target(path: Path) -> Target:
    """Return the package at a path, or of a name below `policy/` or `envs/`.

    Raises:
        NotFoundError: if there is none.
    """
    for candidate in (path, Path("envs") / path):
        if (candidate / "env.yml").is_file():
            return _target(candidate.resolve(), package.ENV)
    if path.is_file():
        raise NotFoundError(
            f"{path} is a file: an audit takes the folder of an adapter", hint=f"xpl audit {path.parent}"
        )
    return _target(package.find_policy(path), package.POLICY)


def _target(folder: Path, kind: str) -> Target:
    here = Path.cwd()
    shown = folder.relative_to(here).as_posix() if folder.is_relative_to(here) else folder.as_posix()
    return Target(folder, kind, shown or ".")
