"""Installation, data processing and training of an adapter, by its own scripts in the policy's interpreter."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import xpl
from xpl import _spec as sdk
from xpl import checkpoint
from xpl.process import script as launcher
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.lifecycle import interpreter
from xpl_cli.lifecycle.python_env import environments
from xpl_cli.lifecycle.python_env.plan import plan_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl.contract import Config
    from xpl.manifest import PythonEnvironment
    from xpl_cli.packages.package import Package

CONFIG_VARIABLE = "XPL_CONFIG"
"""Environment variable with the configuration of a run for a script, as JSON."""

MANIFEST_VARIABLE = "XPL_MANIFEST"
"""Environment variable with policy.yml for a script, as JSON: its Python need not read YAML (`xpl.training`)."""

PATH_VARIABLE = "PYTHONPATH"


def install(folder: Path, environment: PythonEnvironment, *, force: bool = False) -> environments.InstalledEnvironment:
    """Create the environment that a manifest declares unless it is current, and return it.

    Args:
        folder: folder of the package.
        environment: what its policy.yml or env.yml declares.
        force: create it again.

    Raises:
        UserError: if it cannot be created; the former one is kept.
    """
    plan = plan_of(folder, environment)
    if plan is None:
        return environments.InstalledEnvironment(Path(interpreter.resolve(folder, environment)), "given", {})
    return environments.install(plan, force=force)


def condition(folder: Path, environment: PythonEnvironment) -> str:
    """Return the state of a package's environment: "current", "outdated", "missing", "foreign", or "given"."""
    plan = plan_of(folder, environment)
    return "given" if plan is None else environments.condition(plan)


def run_script(
    package: Package, name: str, overrides: Config, gpu: str | None = None, *, to_stderr: bool = False
) -> float:
    """Run an author's script with the configuration of the run in `XPL_CONFIG` (JSON); return how long it took, s.

    The configuration also names the conventional `run_name` of data and checkpoints. `XPL_MANIFEST` holds policy.yml:
    the policy's own Python need not read YAML. `import xpl` works in the script, and in processes that it starts,
    whatever is installed there. With `to_stderr` the script's output goes to standard error.

    Raises:
        NotFoundError: if the adapter has no such script.
        UserError: if the adapter is for evaluation only, or the script fails; the message has its exit code.
    """
    if package.manifest.evaluation_only:
        raise UserError(
            f"{package.name} is for evaluation only: it offers neither data processing nor training",
            hint=f"set evaluation_only: false in {sdk.File.POLICY_YML} if it is to have {name}",
        )
    script = package.path / name
    if not script.is_file():
        raise NotFoundError(
            f"{package.name} has no {name}",
            hint=f"write {script}; it finds its configuration as JSON in ${CONFIG_VARIABLE}",
        )
    config = package.config(overrides)
    config["run_name"] = checkpoint.run_name(config)
    variables = {CONFIG_VARIABLE: json.dumps(config), MANIFEST_VARIABLE: json.dumps(dict(package.manifest.data))}
    environment = {**os.environ, **variables}
    environment.pop("PYTHONHOME", None)  # the tool's own must not redirect the policy's interpreter
    if gpu is not None:
        environment["CUDA_VISIBLE_DEVICES"] = gpu
    python = interpreter.resolve(package.path, package.manifest.environment)
    started = time.monotonic()
    output = sys.stderr if to_stderr else None
    with _sdk_alone() as folder:
        environment[PATH_VARIABLE] = os.pathsep.join(filter(None, (folder, os.environ.get(PATH_VARIABLE))))
        command = [python, launcher.__file__, str(script)]
        done = subprocess.run(command, cwd=package.path, env=environment, stdout=output, check=False)
    if done.returncode:
        raise UserError(f"{script} failed with exit code {done.returncode}", code=ExitCode.NOT_RUN)
    return time.monotonic() - started


@contextmanager
def _sdk_alone() -> Iterator[str]:
    """Yield a folder that makes only `xpl` importable, without this tool and its neighbours."""
    with tempfile.TemporaryDirectory(prefix="xpl-sdk-") as folder:
        (Path(folder) / xpl.__name__).symlink_to(Path(xpl.__file__).parent, target_is_directory=True)
        yield folder


def gpu_setting(gpu: str | None) -> dict[str, str]:
    """Return the configuration override for a device."""
    return {} if gpu is None else {sdk.Deploy.GPU_ID: gpu}
