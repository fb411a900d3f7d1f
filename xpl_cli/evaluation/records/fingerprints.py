"""What a run was made with, as digests: packages, checkpoints, machines."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xpl_cli
from xpl import _spec as sdk
from xpl import checkpoint

if TYPE_CHECKING:
    from xpl.contract import Config
    from xpl_cli.packages.package import Package

Facts = Mapping[str, Any]
"""What results may depend on besides policy and environment (`machine_facts`)."""
_LIBRARIES = ("numpy", "mujoco-core", "gymnasium")
_LEFTOVERS = frozenset({sdk.CHECKPOINT_DIRECTORY, "data", "logs", "results", "runs", "__pycache__"})
"""Folders directly in a package that running leaves there, as the scaffold's .gitignore has it."""


@dataclass(frozen=True)
class LoadedCheckpoint:
    """What was loaded: its path, relative to the adapter where it lies in it, and the digest of its files."""

    path: str
    digest: str


def digest_of(value: object) -> str:
    """Return the SHA-256 of a JSON value, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def files_of(folder: Path) -> list[Path]:
    """Return the own files of a package, relative to its folder and sorted: not what installing or running leaves.

    Hidden folders are left out, virtual environments among them; links to folders are not followed.
    """
    paths: list[Path] = []
    for directory, folders, names in os.walk(folder):
        at_top = Path(directory) == folder
        folders[:] = [name for name in folders if not _is_left_over(name, at_top=at_top)]
        paths += [Path(directory) / name for name in names if not name.endswith((".pyc", ".pyo"))]
    # Neither sockets nor links that lead nowhere.
    own = (path.relative_to(folder) for path in paths if path.is_file())
    return sorted(own, key=lambda path: path.as_posix())


def package_digest(folder: Path) -> str:
    """Return the digest of a package: of the names and contents of its own files."""
    parts = {path.as_posix(): _sha256_of(folder / path) for path in files_of(folder)}
    return digest_of(parts)


def checkpoint_of(package: Package, config: Config) -> LoadedCheckpoint | None:
    """Return path and digest of the checkpoint that a configuration leads to; None where it leads to none.

    Raises:
        UserError: a name in it cannot be written down.
    """
    from xpl_cli.lifecycle.checkpoints.content import hash_checkpoint

    try:
        path = checkpoint.resolve(config, package.path)
    except checkpoint.CheckpointError:
        return None
    name = path.relative_to(package.path) if path.is_relative_to(package.path) else path
    return LoadedCheckpoint(name.as_posix(), hash_checkpoint(path)[0])


def machine_facts() -> Facts:
    """Return what results may depend on besides policy and environment: processor, system, versions."""
    from importlib import metadata

    versions = {}
    for name in _LIBRARIES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    model, features = _processor()
    return {
        "processor": model,
        "features": features,
        "architecture": platform.machine(),
        "system": f"{platform.system()} {' '.join(platform.libc_ver())}".strip(),
        "python": platform.python_version(),
        "xpl": xpl_cli.__version__,
        "libraries": versions,
    }


def _is_left_over(name: str, *, at_top: bool) -> bool:
    return name == "__pycache__" or (name.startswith(".") and name != ".xpl") or (at_top and name in _LEFTOVERS)


def _sha256_of(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _processor() -> tuple[str, str]:
    """Return the processor's name, and a short digest of its features, on which floating-point results depend."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    info = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    features = info.get("flags") or info.get("Features") or ""
    name = info.get("model name") or platform.processor() or platform.machine()
    return name, hashlib.sha256(" ".join(sorted(features.split())).encode()).hexdigest()[:12]
