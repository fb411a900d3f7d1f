"""Targets of an audit: policy and environment packages."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from xpl import _spec as sdk
from xpl_cli.basics.errors import NotFoundError, UserError
from xpl_cli.packages import environments, package, robots

_POLICIES, _ENVIRONMENTS = "policy", "envs"
_ENV_YML = package.MANIFESTS[package.ENV]


@dataclass(frozen=True)
class AuditTarget:
    """One package to audit.

    Attributes:
        path: its folder, absolute.
        kind: `policy` or `env`.
        shown: the folder for reports, relative to the working directory if below it.
    """

    path: Path
    kind: str
    shown: str


def requested_targets(paths: Iterable[Path], *, every: bool = False) -> list[AuditTarget]:
    """Return the requested packages, each once.

    Args:
        paths: folders, or names of packages of the working directory or of xpl.
        every: also every package below `policy/` and `envs/` of the working directory.

    Raises:
        UserError: if none is requested.
        NotFoundError: if there is no such package.
    """
    targets = [find_target(path) for path in paths]
    if every:
        targets += find_all()
    if not targets:
        raise UserError("name a package: xpl audit PATH..., or --all for every one below policy/ and envs/")
    return unique(targets)


def find_target(path: Path) -> AuditTarget:
    """Return the package at a path, or by its name: of the working directory, of xpl, or installed.

    Raises:
        NotFoundError: if there is none.
    """
    for candidate in (path, Path(_ENVIRONMENTS) / path):
        if (candidate / _ENV_YML).is_file():
            return _target(candidate.resolve(), package.ENV)
    if path.is_file():
        raise NotFoundError(
            f"{path} is a file: an audit takes the folder of an adapter", hint=f"`xpl audit {path.parent}`"
        )
    try:
        return _target(package.find_policy(path), package.POLICY)
    except NotFoundError:
        shared = environments.shared_environments().get(str(path))
        if shared is None:
            raise
        return _target(shared.resolve(), package.ENV)


def find_all() -> list[AuditTarget]:
    """Return every package below `policy/` and `envs/` of the working directory, by name.

    Raises:
        NotFoundError: if there is none.
    """
    kinds = ((_POLICIES, package.MARKS, package.POLICY), (_ENVIRONMENTS, (_ENV_YML,), package.ENV))
    targets = [
        _target(folder.resolve(), kind)
        for parent, marks, kind in kinds
        for folder in sorted(Path(parent).glob("*/"))
        if any((folder / mark).is_file() for mark in marks)
    ]
    if not targets:
        raise NotFoundError(
            f"there is no package below policy/ and envs/ of {Path.cwd()}", hint="`xpl new-policy NAME` starts one"
        )
    return unique(targets)


def package_of(file: Path) -> Path | None:
    """Return the outermost package that contains a file: models may vendor whole repositories."""
    return next((folder for folder in reversed(file.parents) if is_package(folder)), None)


def is_package(folder: Path) -> bool:
    """Tell whether a folder is a package: by its manifest or, for adapters without one, by its location and files."""
    if any((folder / name).is_file() for name in package.MANIFESTS.values()):
        return True
    files = (sdk.File.MODEL_PY, sdk.File.DEPLOY_YML)
    return folder.parent.name == _POLICIES and any((folder / name).is_file() for name in files)


def unique(targets: Iterable[AuditTarget]) -> list[AuditTarget]:
    """Return the packages without repetitions, in their order."""
    return list({target.path: target for target in targets}.values())


def _target(folder: Path, kind: str) -> AuditTarget:
    robots.register_robots(folder)
    here = Path.cwd()
    shown = folder.relative_to(here).as_posix() if folder.is_relative_to(here) else folder.as_posix()
    return AuditTarget(folder, kind, shown or ".")
