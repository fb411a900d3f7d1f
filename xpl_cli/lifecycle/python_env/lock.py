"""Lock of an environment: every package with its version and digests, resolved by uv if available, else by pip.

Format: pip's requirements file, one line for each package. The first line names what was resolved, so that a lock of
other requirements is noticed.
"""

from __future__ import annotations

import platform
import shutil
import subprocess
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl import json_text
from xpl_cli.basics import atomic
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.lifecycle.python_env import installers, pythons
from xpl_cli.lifecycle.python_env.requirements import HEADER, digest_of, inputs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.manifest import PythonEnvironment

NAME: Final = "requirements.lock"


@dataclass(frozen=True)
class LockedEnvironment:
    """A lock that was written.

    Attributes:
        path: its file.
        packages: number of packages.
        resolver: program that resolved them.
    """

    path: Path
    packages: int
    resolver: str


def write(folder: Path, declared: PythonEnvironment) -> LockedEnvironment:
    """Resolve the requirements of a package and write its lock.

    Args:
        folder: folder of the package.
        declared: its environment.

    Raises:
        UserError: they cannot be resolved.
    """
    requirements = inputs(declared)
    path = folder / (declared.lock or NAME)
    if path.suffix not in (".txt", ".lock") or path.name == "uv.lock":
        raise UserError(f"`xpl lock` writes pip's format (*.lock or *.txt), and the manifest names {path.name}")
    uv = shutil.which("uv")
    if uv:
        version = declared.python or platform.python_version()
        resolved = _by_uv(uv, requirements, pythons.for_uv(declared.python), folder)
    else:
        python = pythons.find(declared.python)
        version = pythons.version_of(python) or platform.python_version()
        resolved = _by_pip(requirements, python, folder)
    header = HEADER.format(
        python=version, platform=f"{platform.system().lower()}-{platform.machine()}", digest=digest_of(requirements)
    )
    lines = [
        " ".join([f"{name}=={release}", *(f"--hash=sha256:{one}" for one in sorted(hashes))])
        for name, release, hashes in resolved
    ]
    atomic.write_file(path, "\n".join([header, *sorted(lines, key=str.lower), ""]).encode())
    return LockedEnvironment(path, len(lines), "uv" if uv else "pip")


_Resolved = tuple[str, str, set[str]]


def _by_uv(uv: str, requirements: Sequence[str], python: str, folder: Path) -> list[_Resolved]:
    with tempfile.TemporaryDirectory() as scratch:
        listed, locked = Path(scratch) / "requirements.in", Path(scratch) / "pylock.toml"
        listed.write_text("".join(f"{line}\n" for line in requirements), encoding="utf-8")
        _run([uv, "pip", "compile", "--quiet", str(listed), "--python", python, "--output-file", str(locked)], folder)
        packages: list[dict[str, Any]] = tomllib.loads(locked.read_text(encoding="utf-8")).get("packages", [])
    return [(one["name"], one["version"], _hashes(one)) for one in packages]


def _hashes(package: dict[str, Any]) -> set[str]:
    """Return the digests of a package's wheels for this platform, or of its source if it has none."""
    files = package.get("wheels") or [package.get("sdist", {})]
    found = {file["hashes"]["sha256"] for file in files if "sha256" in file.get("hashes", {})}
    if not found:
        raise UserError(f"{package['name']} {package.get('version')} has no file with a digest: it cannot be locked")
    return found


def _by_pip(requirements: Sequence[str], python: str, folder: Path) -> list[_Resolved]:
    with tempfile.TemporaryDirectory() as scratch:
        environment, report = Path(scratch) / "env", Path(scratch) / "report.json"
        _run([python, "-I", "-m", "venv", str(environment)], folder)  # pip resolves for the interpreter that it runs in
        pip = [str(environment / "bin" / "python"), "-I", "-m", "pip", "install", "--quiet", "--no-input", "--dry-run"]
        _run([*pip, "--ignore-installed", "--report", str(report), *requirements], folder)
        items = json_text.parse(report.read_text(encoding="utf-8"))["install"]
    return [
        (
            one["metadata"]["name"].lower().replace("_", "-"),
            one["metadata"]["version"],
            {one["download_info"]["archive_info"]["hashes"]["sha256"]},
        )
        for one in items
    ]


def _run(command: Sequence[str], folder: Path) -> None:
    done = subprocess.run(
        command,
        cwd=folder,
        env=installers.environment(),
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    if done.returncode:
        lines = [line for line in (done.stderr or done.stdout).strip().splitlines() if line.strip()]
        raise UserError(
            f"the requirements of {folder.name} cannot be resolved: {' '.join(lines[-4:]) or done.returncode}",
            hint="`environment.requirements` and `environment.sources` of the manifest are what is resolved",
            code=ExitCode.NOT_RUN,
        )
