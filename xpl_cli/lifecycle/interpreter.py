"""Select the interpreter of an adapter: the tool's own, a path, a virtual environment or a conda environment.

The command line comes first: `--python`, then `--policy-env`. Otherwise `environment` in policy.yml decides, with the
environment that `xpl install` created. There is no other source and no fallback: a missing interpreter is an error.
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
"""Placeholders of launchers for an argument that is not given."""


def resolve(
    policy_dir: Path, environment: PythonEnvironment, *, python: str | None = None, env: str | None = None
) -> str:
    """Return the interpreter for an adapter.

    Args:
        policy_dir: folder of the adapter; relative environment folders start there.
        environment: declaration of its manifest, used if neither option is given.
        python: path of an interpreter, or the name of one on PATH.
        env: `conda:NAME`, `uv:DIR`, `venv:DIR`, the name of a conda environment, or `none` for the tool's own; `-`,
            `null` and an empty text count as not given, since launch scripts always pass the argument.

    Raises:
        UserError: if the requested interpreter does not exist.
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
    """Return the interpreter that policy.yml declares."""
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
    # The environment itself, not the link to it: a running process keeps it when another one is installed.
    hint = f"`xpl install {content.package_argument(policy_dir)}`"
    return _executable(folder.resolve() / "bin" / "python", hint=hint)


def _warn_if_outdated(plan: EnvironmentPlan) -> None:
    """Warn once if an environment is outdated by its manifest or lockfile."""
    try:
        outdated = condition(plan) == "outdated"
    except UserError:
        return  # commands that need the lockfile report the error
    if outdated and plan.base not in _warned:
        _warned.add(plan.base)
        console.note(f"warning: the environment of {plan.package} is not the declared one; xpl install {plan.base}")


def _conda_prefix(name: str) -> Path:
    conda = next(filter(None, map(shutil.which, CONDAS)), None)
    if conda is None:
        raise UserError(f"conda environment {name!r} was requested, but conda is not on PATH", code=ExitCode.NOT_RUN)
    listed = subprocess.run([conda, "env", "list", "--json"], capture_output=True, text=True, check=False, timeout=60)
    prefixes = [Path(prefix) for prefix in json_text.parse(listed.stdout or "{}").get("envs", [])]
    for prefix in prefixes:
        if name in (prefix.name, str(prefix)):
            return prefix
    names = ", ".join(prefix.name for prefix in prefixes) or "none"
    raise UserError(f"there is no conda environment {name!r}; there are: {names}", code=ExitCode.NOT_RUN)


def _path(python: str) -> Path:
    """Return the path of an interpreter; a name without a slash is searched on PATH first, as by a shell."""
    return Path((os.sep not in python and shutil.which(python)) or python)


def _executable(path: Path, hint: str | None = None) -> str:
    # Not resolved: a virtual environment's python is a link, and its own path is what makes it one.
    try:
        executable = path.expanduser().absolute()
        is_there = executable.is_file()
    except (OSError, RuntimeError):  # an invalid name; the home folder of an unknown user
        is_there = False
    if not is_there:
        raise UserError(f"there is no interpreter at {path}", hint=hint, code=ExitCode.NOT_RUN)
    if not os.access(executable, os.X_OK):
        raise UserError(f"{path} is no interpreter: it is not executable", code=ExitCode.NOT_RUN)
    return str(executable)
