"""Environment packages: look them up by name, and load them in this process or in others."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import registry
from xpl.manifest import EnvManifest
from xpl_cli.basics import console, content
from xpl_cli.basics.errors import ExitCode, UnknownTargetError, UserError, no_such
from xpl_cli.packages import manifests, package, robots

if TYPE_CHECKING:
    from types import ModuleType

    from xpl.contract import Config
    from xpl.environment import TaskEnv

_MANIFEST = package.MANIFESTS[package.ENV]
_PROJECT = Path("envs")
"""Environments of a project; those of xpl and of installed packages take precedence."""
_warned: set[Path] = set()
"""Shadowed folders that the user was warned about."""
_PERSON_S = 8 * 3600.0
"""How long a reset may wait for an operator."""


def find(name: str) -> Path:
    """Return the folder of an environment package.

    Args:
        name: a path; or the name of an environment of xpl, of an installed package, or below `envs/`.

    Registers the robots that it and its project describe.

    Raises:
        UnknownTargetError: if there is none; lists the names.
        EntryPointError: if an installed package's environments cannot be used.
        UserError: if a file describes no valid robot, or one whose name is taken.
    """
    is_path = len(Path(name).parts) != 1 or name.startswith(".")
    candidate = None if is_path else shared_environments().get(name)
    own = next((folder for folder in (Path(name), _PROJECT / name) if (folder / _MANIFEST).is_file()), None)
    if candidate is None:
        candidate = own
    elif own is not None and own.resolve() != candidate.resolve() and own not in _warned:
        # The evaluation must not depend on the working directory, which may be a third party's checkout.
        _warned.add(own)
        console.note(f"warning: {name} is {candidate}; use ./{own} for the one in {own}")
    if candidate is None:
        raise no_such(f"there is no environment {name!r}", name, names(), kind=UnknownTargetError)
    folder = candidate.resolve()
    robots.register_robots(folder)
    return folder


def names() -> list[str]:
    """Return the names of all environments: in `envs/` of the working directory, of xpl and of installed packages."""
    return sorted({*_in(_PROJECT), *shared_environments()})


def shared_environments() -> dict[str, Path]:
    """Return the folders of the environments of xpl and of installed packages, by name.

    Raises:
        EntryPointError: if two packages have environments of the same name.
    """
    environments = _in(content.content_folder("envs"))
    origins = dict.fromkeys(environments, registry.BUILT_IN_DISTRIBUTION)
    for folder, source in registry.folders(registry.ENVS).items():
        for name, path in _in(folder).items():
            if name in environments:
                raise source.unusable(f"{path} and {environments[name]} of {origins[name]} are both called {name}")
            environments[name], origins[name] = path, source.distribution
    return environments


def _in(folder: Path) -> dict[str, Path]:
    return {entry.parent.name: entry.parent for entry in folder.glob(f"*/{_MANIFEST}")}


def manifest(folder: Path) -> EnvManifest:
    """Return the manifest of an environment."""
    return EnvManifest.parse(manifests.read(folder / _MANIFEST, package.ENV))


def module(name: str, part: str = "client") -> ModuleType:
    """Load a module of an environment package."""
    return content.load_module(find(name) / f"{part}.py")


def require_simulation(name: str) -> None:
    """Raise if an environment may be a real robot.

    Raises:
        UserError: if env.yml does not declare a simulation.
    """
    if manifest(find(name)).is_real:
        raise UserError(
            f"{name} does not declare `real_time: false`, so it may be a real robot, which this would move",
            hint="set `real_time: false` in env.yml if it is a simulation; `xpl eval` moves robots",
            code=ExitCode.NOT_RUN,
        )


def make(name: str, config: Config) -> TaskEnv:
    """Return a task environment in this process."""
    env: TaskEnv = content.load_module(_client(find(name))).make(config)
    return env


def start(name: str, config: Config, *, workers: int = 1, python: str | None = None) -> Any:
    """Return a task environment that enforces its robot's limits, by a guard where necessary.

    Args:
        name: the package, or its folder.
        config: configuration, with embodiment, action_type and task.
        workers: processes that share the environments; 0 for this process.
        python: interpreter of the processes.

    Raises:
        UserError: if the environment rejects the configuration, or cannot run here.
    """
    from xpl.environment import NotInstalledError
    from xpl.simulator.process import EnvLostError, EnvRaisedError
    from xpl.simulator.worker_pool import EnvTimeouts
    from xpl.vector import VectorEnv

    folder = find(name)
    if not workers and python not in (None, sys.executable):
        raise UserError(f"{name} runs in {python}, not in this process: use at least one worker")
    try:
        if workers:
            # With a real robot, an operator resets the scene: a long reset is no hang.
            # The last step may also ask the operator for the outcome.
            facts = manifest(folder)
            asks = {"step_s": _PERSON_S} if facts.robot else {}
            limits = EnvTimeouts(start_s=_PERSON_S, **asks) if facts.real_time else None
            env: Any = VectorEnv(_client(folder), config, workers=workers, python=python, limits=limits)
        else:
            env = content.load_module(_client(folder)).make(config)
    except ValueError as error:
        raise UserError(f"{name}: {error}") from None
    except NotInstalledError as error:
        raise UserError(f"{name} cannot run: {error}", code=ExitCode.NOT_RUN) from None
    except (EnvRaisedError, EnvLostError) as error:
        message = str(error)
        if isinstance(error, EnvRaisedError) and error.kind == NotInstalledError.__name__:
            message = error.message
        raise UserError(f"{name} cannot run: {message}", code=ExitCode.NOT_RUN) from None
    return env if getattr(env, "guarded", False) else _guarded(env, config, manifest(folder))


def _client(folder: Path) -> Path:
    return folder / manifest(folder).client


def _guarded(env: TaskEnv, config: Config, facts: EnvManifest) -> Any:
    from xpl import get_embodiment
    from xpl.guard import GuardedEnv
    from xpl.safety import Supervisor

    robot, control = get_embodiment(config["embodiment"]), config[sdk.Deploy.ACTION_TYPE]
    rate = facts.frequency(config.get("task"))
    # An environment counts as real time unless it declares a simulation.
    clock = _stopped if facts.real_time is False else time.monotonic
    return GuardedEnv(env, lambda: Supervisor(robot, control, rate), clock)


def _stopped() -> float:
    """Return the constant clock of a simulation, s: it waits for the policy, so actions do not age."""
    return 0.0
