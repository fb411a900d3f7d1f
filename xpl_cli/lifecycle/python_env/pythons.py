"""Python interpreters of this machine."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from xpl_cli.basics.errors import ExitCode, UserError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from packaging.specifiers import SpecifierSet

_OLDEST, _NEWEST = 9, 15
_BARE = re.compile(r"3(\.\d+){0,2}")
_PROBE = "import platform, venv, ensurepip; print(platform.python_version())"
_PROBE_S = 10.0


def find(requested: str | None) -> str:
    """Return an interpreter that can create environments.

    Args:
        requested: a version such as `3.10`, or a range such as `>=3.10,<3.12`; None for the tool's own interpreter.

    Raises:
        UserError: if PATH and pyenv have none.
    """
    if requested is None:
        return sys.executable
    versions = specifier(requested)
    tried = []
    for candidate in _candidates(requested):
        version = version_of(candidate)
        if version and versions.contains(version, prereleases=True):
            return candidate
        if version:
            tried.append(version)
    available = f"; PATH has {', '.join(sorted(set(tried)))}" if tried else ""
    raise UserError(
        f"there is no Python {requested} that can create environments{available}",
        hint="install it (on Debian with python3-venv), or install uv, which brings interpreters of any version",
        code=ExitCode.NOT_RUN,
    )


def for_uv(requested: str | None) -> str:
    """Return an interpreter for uv: the one that `find` returns, or the request itself, because uv can bring others."""
    try:
        return find(requested)
    except UserError:
        return str(requested)


def specifier(requested: str) -> SpecifierSet:
    """Parse a version or a range of versions; `3.10` means every 3.10.

    Raises:
        UserError: if it is malformed.
    """
    from packaging.specifiers import InvalidSpecifier, SpecifierSet

    text = requested.strip()
    if _BARE.fullmatch(text):
        text = f"=={text}" if text.count(".") == 2 else f"=={text}.*"
    try:
        return SpecifierSet(text)
    except InvalidSpecifier:
        raise UserError(
            f"expected a version of Python such as 3.10, or a range such as >=3.10,<3.12, got {requested!r}"
        ) from None


def version_of(python: str) -> str | None:
    """Return the version of an interpreter; None if it does not run or cannot create environments."""
    try:
        done = subprocess.run(
            [python, "-I", "-c", _PROBE], capture_output=True, text=True, check=False, timeout=_PROBE_S
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def names() -> list[str]:
    """Return the program names of interpreters, newest first."""
    return [f"python3.{minor}" for minor in range(_NEWEST, _OLDEST - 1, -1)]


def _candidates(requested: str) -> Iterator[str]:
    minor = re.search(r"3\.\d+", requested)
    exact = [f"python{minor[0]}"] if minor else []
    yielded: set[str] = set()
    for name in (sys.executable, *exact, *names(), "python3", "python"):
        path = shutil.which(name)
        if path and (real := os.path.realpath(path)) not in yielded:
            yielded.add(real)
            yield path
    # A shim of pyenv that is on PATH runs a version only where somebody selected it.
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    yield from map(str, sorted(pyenv.glob(f"versions/{minor[0] if minor else ''}*/bin/python3")))
