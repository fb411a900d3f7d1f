"""Which interpreter runs an adapter: the tool's own, a path, a virtual environment or a conda environment."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl_cli.errors import ExitCode, UserError

if TYPE_CHECKING:
    from collections.abc import Mapping

_OWN = frozenset(("", "none", "-", "null"))


def resolve(policy_dir: Path, manifest: Mapping[str, Any], *, python: str | None = None, env: str | None = None) -> str:
    """Return the interpreter for an adapter.

    Args:
        policy_dir: folder of the adapter; relative environment folders start there.
        manifest: its policy.yml; `environment` is what counts if neither option is given.
        python: path of an interpreter.
        env: `conda:NAME`, `uv:DIR`, `venv:DIR`, the name of a conda environment, or `none` for the tool's own.

    Raises:
        UserError: if what was asked for does not exist.
    """
    if python:
        return _executable(Path(python))
    if env is not None:
        if env in _OWN:
            return sys.executable
        manager, separator, name = env.partition(":")
        return _managed(manager if separator else "conda", name if separator else env, policy_dir)
    declared = manifest.get("environment") or {}
    manager = declared.get("manager", "none")
    if manager == "none":
        return sys.executable
    if manager == "path":
        return _executable(Path(str(declared.get("python"))))
    return _managed(manager, declared.get("name") or (policy_dir.name if manager == "conda" else ".venv"), policy_dir)


def _managed(manager: str, name: str, policy_dir: Path) -> str:
    if manager in ("venv", "uv"):
        return _executable((policy_dir / name).expanduser() / "bin" / "python", hint=f"xpl install {policy_dir}")
    if manager == "conda":
        return _executable(_conda_prefix(name) / "bin" / "python")
    raise UserError(f"unknown kind of environment {manager!r}: expected conda, uv, venv, path or none")


def _conda_prefix(name: str) -> Path:
    conda = shutil.which("conda") or shutil.which("mamba") or shutil.which("micromamba")
    if conda is None:
        raise UserError(f"conda environment {name!r} was asked for, but conda is not on PATH", code=ExitCode.NOT_RUN)
    listed = subprocess.run([conda, "env", "list", "--json"], capture_output=True, text=True, check=False, timeout=60)
    prefixes = [Path(prefix) for prefix in json.loads(listed.stdout or "{}").get("envs", [])]
    for prefix in prefixes:
        if name in (prefix.name, str(prefix)):
            return prefix
    known = ", ".join(prefix.name for prefix in prefixes) or "none"
    raise UserError(f"there is no conda environment {name!r}; there are: {known}", code=ExitCode.NOT_RUN)


def _executable(path: Path, hint: str | None = None) -> str:
    # Not resolved: a virtual environment's python is a link, and its own path is what makes it one.
    if not path.expanduser().is_file():
        raise UserError(f"there is no interpreter at {path}", hint=hint, code=ExitCode.NOT_RUN)
    return str(path.expanduser().absolute())
