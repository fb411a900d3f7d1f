"""Installers of environments: uv if available, else venv and pip; conda for conda lockfiles.

Each runs as a program of its own, without environment variables that could redirect it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import json_text
from xpl_cli.basics import console
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.lifecycle.python_env import pythons, sources
from xpl_cli.lifecycle.python_env.plan import CONDA

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.lifecycle.python_env.plan import EnvironmentPlan

CONDAS = ("conda", "mamba", "micromamba")
OLDEST_PYTHON = (3, 9)

_LIMIT_S = 100.0
"""Timeout of a new interpreter; the first import of large packages is slow."""

_ELSEWHERE = ("VIRTUAL_ENV", "CONDA_PREFIX", "PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP", "__PYVENV_LAUNCHER__")
_PIP = ("TARGET", "PREFIX", "ROOT", "USER", "PYTHON", "REQUIREMENT", "CONSTRAINT", "EDITABLE", "UPGRADE", "NO_DEPS")
_PIP_MODES = ("DRY_RUN", "REQUIRE_VIRTUALENV", "REPORT", "IGNORE_INSTALLED", "NO_COMPILE")
_UV = ("PYTHON", "PROJECT", "PROJECT_ENVIRONMENT", "SYSTEM_PYTHON", "CONSTRAINT", "OVERRIDE", "WORKING_DIRECTORY")
_UV_MODES = ("BREAK_SYSTEM_PACKAGES", "VENV_CLEAR", "VENV_SEED", "FROZEN", "LOCKED", "EDITABLE", "NO_EDITABLE")
LISTING = """
import json, platform, sys
from importlib.metadata import distributions
found = {d.metadata["Name"]: d.version for d in distributions() if d.metadata["Name"]}
print(json.dumps({"python": platform.python_version(), "installed": dict(sorted(found.items(), key=str))}))
"""
"""Program that prints its interpreter's version and installed packages, as JSON."""


def build(plan: EnvironmentPlan, folder: Path) -> dict[str, Any]:
    """Create the environment of a plan in a new folder, and return the installed packages.

    Raises:
        UserError: if a program is missing or fails, or the environment cannot run a policy.
    """
    if plan.manager == CONDA:
        installer = _conda(plan, folder)
    elif uv := shutil.which("uv"):
        installer = _uv(uv, plan, folder)
    elif plan.kind == "uv":
        raise UserError(
            f"{plan.lock} is a lockfile of uv, and uv is not on PATH", hint="install uv", code=ExitCode.NOT_RUN
        )
    else:
        installer = _pip(plan, folder)
    added = sources.add(plan, folder, lambda root: _install_folder(plan, folder, root))
    if added:
        compile_bytecode(folder)
    return {"installer": installer, "sources": added, **_inspect(plan, folder / "bin" / "python")}


def environment() -> dict[str, str]:
    """Return the environment variables of an installer, without those that set its target.

    Both installers compile bytecode: in a read-only container or sandbox, every load would compile all imports again,
    and an audit loads a model some twenty times.
    """
    pip, uv = (f"PIP_{name}" for name in (*_PIP, *_PIP_MODES)), (f"UV_{name}" for name in (*_UV, *_UV_MODES))
    unwanted = {*_ELSEWHERE, *pip, *uv}
    inherited = {name: value for name, value in os.environ.items() if name not in unwanted}
    chosen = {"PYTHONNOUSERSITE": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1", "UV_COMPILE_BYTECODE": "1"}
    return {**inherited, **chosen}


def compile_bytecode(folder: Path) -> None:
    """Compile files without current bytecode: sources on an environment's path, and files that an overlay replaced."""
    # Files that this Python cannot compile, such as templates, are no failure.
    command = [str(folder / "bin" / "python"), "-I", "-m", "compileall", "-q", str(folder)]
    subprocess.run(command, env=environment(), capture_output=True, check=False, stdin=subprocess.DEVNULL)


def _uv(uv: str, plan: EnvironmentPlan, folder: Path) -> str:
    python = pythons.for_uv(plan.python)
    if plan.kind == "uv":
        # The adapter's own folder is no distribution: it runs in place.
        command = [uv, "sync", "--quiet", "--frozen", "--no-dev", "--no-install-project", "--python", python]
        _run(plan, command, UV_PROJECT_ENVIRONMENT=str(folder))
    else:
        _run(plan, [uv, "venv", "--quiet", "--no-project", "--python", python, str(folder)])
        inside = ["--python", str(folder / "bin" / "python")]
        _run(plan, [uv, "pip", "install", "--quiet", *inside, *_install_arguments(plan)])
        _warn_if_inconsistent(plan, [uv, "pip", "check", "--quiet", *inside])
    return _version([uv, "--version"])


def _pip(plan: EnvironmentPlan, folder: Path) -> str:
    _run(plan, [pythons.find(plan.python), "-I", "-m", "venv", str(folder)])
    pip = [str(folder / "bin" / "python"), "-I", "-m", "pip"]
    _run(plan, [*pip, "install", "--quiet", "--no-input", *_install_arguments(plan)])
    _warn_if_inconsistent(plan, [*pip, "check"])
    return _version([*pip, "--version"])


def _install_folder(plan: EnvironmentPlan, folder: Path, root: Path) -> None:
    """Install a folder as a package, without dependencies: the lock or the requirements name them."""
    python = str(folder / "bin" / "python")
    if uv := shutil.which("uv"):
        _run(plan, [uv, "pip", "install", "--quiet", "--no-deps", "--python", python, str(root)])
    else:
        _run(plan, [python, "-I", "-m", "pip", "install", "--quiet", "--no-input", "--no-deps", str(root)])


def _conda(plan: EnvironmentPlan, folder: Path) -> str:
    conda = next(filter(None, map(shutil.which, CONDAS)), None)
    if conda is None:
        raise UserError(
            f"{plan.lock} is a lockfile of conda, and conda is not on PATH", hint="install it", code=ExitCode.NOT_RUN
        )
    if plan.is_explicit() or Path(conda).name == "micromamba":
        command = [conda, "create", "--yes", "--quiet"]
    else:
        command = [conda, "env", "create", "--quiet"]
    _run(plan, [*command, "--prefix", str(folder), "--file", str(plan.lock)])
    return f"{Path(conda).name} {_version([conda, '--version'])}"


def _install_arguments(plan: EnvironmentPlan) -> list[str]:
    """Return the install arguments for uv and pip."""
    if plan.lock is None:
        return list(plan.requirements)
    # A lockfile is complete: unlisted dependencies would have unpinned versions.
    return ["--no-deps", *(["--require-hashes"] if plan.has_hashes() else []), "--requirement", str(plan.lock)]


def _warn_if_inconsistent(plan: EnvironmentPlan, command: Sequence[str]) -> None:
    """Warn about unmet requirements of packages; some lockfiles ignore them on purpose, so this is no error."""
    done = subprocess.run(
        command, cwd=plan.base, env=environment(), capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL
    )
    if done.returncode:
        console.note(f"warning: packages of {plan.package} do not fit together:\n{(done.stdout + done.stderr).strip()}")


def _inspect(plan: EnvironmentPlan, python: Path) -> dict[str, Any]:
    """Return what an environment has, and raise if it cannot run a worker."""
    listing = _output(plan, [str(python), "-I", "-c", LISTING], "its interpreter does not run")
    packages: dict[str, Any] = json_text.parse(listing)
    if tuple(map(int, packages["python"].split(".")[:2])) < OLDEST_PYTHON:
        raise UserError(f"{plan.package} needs Python 3.9 or newer, got {packages['python']}", code=ExitCode.NOT_RUN)
    if plan.python is not None and not pythons.specifier(plan.python).contains(packages["python"], prereleases=True):
        raise UserError(
            f"{plan.package} declares Python {plan.python}, but its lock brings {packages['python']}",
            code=ExitCode.NOT_RUN,
        )
    _output(
        plan,
        [str(python), "-I", "-c", "import numpy"],
        "it has no numpy that can be imported, which serving needs",
        hint="add numpy to the lock or the requirements",
    )
    return packages


def _output(plan: EnvironmentPlan, command: list[str], complaint: str, hint: str | None = None) -> str:
    try:
        done = subprocess.run(
            command, cwd=plan.base, env=environment(), capture_output=True, text=True, check=False, timeout=_LIMIT_S
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UserError(f"the environment of {plan.package}: {complaint}: {error}", code=ExitCode.NOT_RUN) from None
    if done.returncode:
        last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise UserError(f"the environment of {plan.package}: {complaint}: {last}", hint=hint, code=ExitCode.NOT_RUN)
    return done.stdout


def _version(command: Sequence[str]) -> str:
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=False)
    return " ".join(done.stdout.split()[:2])


def _run(plan: EnvironmentPlan, command: Sequence[str], **variables: str) -> None:
    # The output of installers goes to stderr: stdout is for answers.
    done = subprocess.run(
        command,
        cwd=plan.base,
        env={**environment(), **variables},
        check=False,
        stdin=subprocess.DEVNULL,
        stdout=sys.stderr,
    )
    if done.returncode:
        command_text = " ".join([Path(command[0]).name, *command[1:4]])
        raise UserError(
            f"the environment of {plan.package} cannot be created: {command_text} ... ended with {done.returncode}",
            hint="its output is above; the former environment is unchanged",
            code=ExitCode.NOT_RUN,
        )
