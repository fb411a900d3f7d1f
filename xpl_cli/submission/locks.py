"""The environment lock of a bundle: which interpreters ran policy and environments, and all that is installed there."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import json_text
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.lifecycle import interpreter
from xpl_cli.lifecycle.python_env import installers

if TYPE_CHECKING:
    from xpl.manifest import PythonEnvironment

_LIMIT_S = 100.0


def lock_of(folder: Path, environment: PythonEnvironment, *, python: str | None = None, env: str | None = None) -> Any:
    """Return the lock of a package's interpreter: `submission#/$defs/interpreter`.

    Args:
        folder: the adapter's or environment's.
        environment: the declaration in its manifest.
        python: its interpreter, as `interpreter.resolve` takes it.
        env: the environment of its interpreter, likewise.

    Raises:
        UserError: there is no such interpreter, or it does not run.
    """
    interpreter_path = interpreter.resolve(folder, environment, python=python, env=env)
    declared = environment.lock
    lock = None if declared is None else {"path": declared, "sha256": _sha256(folder / declared)}
    return {**_installed_packages(interpreter_path), "lock": lock}


def _installed_packages(python: str) -> dict[str, Any]:
    """Return an interpreter's version, and its packages with theirs."""
    # -I: neither the working directory nor the user's variables add packages.
    command = [python, "-I", "-c", installers.LISTING]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=_LIMIT_S)
    except (OSError, subprocess.SubprocessError) as error:
        raise UserError(f"{python} does not say which packages it has: {error}", code=ExitCode.NOT_RUN) from None
    listing: dict[str, Any] = json_text.parse(done.stdout)
    return listing


def _sha256(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise UserError(f"the lock {path} cannot be read: {error.strerror}") from None
