"""Which interpreter runs an adapter: the tool's own, a path, a virtual environment or a conda environment.

What a command line says comes first: `--python`, then `--env`. Otherwise `environment` in policy.yml decides; what
`xpl install` made from it is found by itself. There is no further source, and no fallback: an interpreter that was
asked for and is not there is an error.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import json_text
from xpl_cli.basics import console, content
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.lifecycle.python_env.environments import condition
from xpl_cli.lifecycle.python_env.installers import CONDAS
from xpl_cli.lifecycle.python_env.plan import CONDA, MADE_BY_XPL, plan_of

if TYPE_CHECKING:
    from xpl.manifest import PythonEnvironment
    from xpl_cli.lifecycle.python_env.plan import EnvironmentPlan

_warned: set[Path] = set()
_OWN = "none"
_NOT_GIVEN = frozenset(("", "-", "null"))
"""What launchers put where an argument is not given."""


def resolve(
    policy_dir: Path, environment: PythonEnvironment, *, python: str | None = None, env: str | None = None
) -> str:
    """Return the interpreter for an adapter.

    Args:
        policy_dir: folder of the adapter; relative environment folders start there.
        environment: what its manifest declares; it counts if neither option is given.
        python: path of an interpreter, or the name of one on PATH.
        env: `conda:NAME`, `uv:DIR`, `venv:DIR`, the name of a conda environment, or `none` for the tool's own; `-`,
            `null` and nothing are as good as not given, since the launch scripts have an argument for it.

    Raises:
        UserError: if what was asked for does not exist.
    """
    if python:
        return _executable(_path(python))
    if env == _OWN:
        return sys.executable
    if env is not None and env not in _NOT_GIVEN:
        manager, separator, name = env.partition(":")
        return _managed(manager if separator else CONDA, name if separator else env, policy_dir)
    return _declared(policy_dir, environment)


def _declared(policy_dir: Path, environment: PythonEnvironment) -> str:
    """Return the interpreter that policy.yml says."""
    manager = environment.manager
    if manager == "none":
        return sys.executable
    if manager == "path":
        return _executable(_path(str(environment.python)))
    plan = plan_of(policy_dir, environment)
    if plan is None:
        return _managed(manager, environment.name or policy_dir.name, policy_dir)
    _warn_if_outdated(plan)
    return _in_folder(plan.link, policy_dir)


def _managed(manager: str, name: str, policy_dir: Path) -> str:
    if manager in MADE_BY_XPL:
        return _in_folder(policy_dir / Path(name).expanduser(), policy_dir)
    if manager == CONDA:
        return _executable(_conda_prefix(name) / "bin" / "python")
    raise UserError(f"unknown kind of environment {manager!r}: expected conda, uv, venv, path or none")


def _in_folder(folder: Path, policy_dir: Path) -> str:
    # The environment itself, not the link to it: whoever starts in it stays in it when another one is installed.
    hint = f"`xpl install {content.package_argument(policy_dir)}`"
    return _executable(folder.resolve() / "bin" / "python", hint=hint)


def _warn_if_outdated(plan: EnvironmentPlan) -> None:
    """Say once that an environment was made from something else than its manifest and lock say now."""
    try:
        outdated = condition(plan) == "outdated"
    except UserError:
        return  # who needs the lock says what is wrong with it
    if outdated and plan.base not in _warned:
        _warned.add(plan.base)
        console.note(f"warning: the environment of {plan.package} is not the declared one; xpl install {plan.base}")


def _conda_prefix(name: str) -> Path:
    conda = next(filter(None, map(shutil.which, CONDAS)), None)
    if conda is None:
        raise UserError(f"conda environment {name!r} was asked for, but conda is not on PATH", code=ExitCode.NOT_RUN)
    listed = subprocess.run([conda, "env", "list", "--json"], capture_output=True, text=True, check=False, timeout=60)
    prefixes = [Path(prefix) for prefix in json_text.parse(listed.stdout or "{}").get("envs", [])]
    for prefix in prefixes:
        if name in (prefix.name, str(prefix)):
            return prefix
    known = ", ".join(prefix.name for prefix in prefixes) or "none"
    raise UserError(f"there is no conda environment {name!r}; there are: {known}", code=ExitCode.NOT_RUN)


def _path(python: str) -> Path:
    """Return where an interpreter lies: what has no slash is looked for on PATH first, as by a shell."""
    return Path((os.sep not in python and shutil.which(python)) or python)


def _executable(path: Path, hint: str | None = None) -> str:
    # Not resolved: a virtual environment's python is a link, and its own path is what makes it one.
    try:
        found = path.expanduser().absolute()
        is_there = found.is_file()
    except (OSError, RuntimeError):  # a name that no system bears; a home folder of nobody
        is_there = False
    if not is_there:
        raise UserError(f"there is no interpreter at {path}", hint=hint, code=ExitCode.NOT_RUN)
    if not os.access(found, os.X_OK):
        raise UserError(f"{path} is no interpreter: it is not executable", code=ExitCode.NOT_RUN)
    return str(found)
