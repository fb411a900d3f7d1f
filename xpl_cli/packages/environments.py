"""Environment packages: found by name, loaded by path, here or in processes of their own."""

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
"""Where a project keeps its environments; those of ours and of installed packages go before them."""
_warned: set[Path] = set()
"""Folders of which it was said that they are not meant by their name."""
_PERSON_S = 8 * 3600.0
"""How long a reset may wait for a person."""


def find(name: str) -> Path:
    """Return the folder of an environment package.

    Args:
        name: a path; or a name among ours, in an installed package, or below `envs/` of the working directory.

    The robots that it and its project describe are known from then on.

    Raises:
        UnknownTargetError: with the names that there are.
        EntryPointError: an installed package's environments cannot be used.
        UserError: a file does not describe a robot, or one whose name is taken.
    """
    is_path = len(Path(name).parts) != 1 or name.startswith(".")
    candidate = None if is_path else shared_environments().get(name)
    own = next((place for place in (Path(name), _PROJECT / name) if (place / _MANIFEST).is_file()), None)
    if candidate is None:
        candidate = own
    elif own is not None and own.resolve() != candidate.resolve() and own not in _warned:
        # What judges must not depend on the folder that somebody stands in, which may be a stranger's checkout.
        _warned.add(own)
        console.note(f"warning: {name} is {candidate}; the one in {own} is meant by its path, ./{own}")
    if candidate is None:
        raise no_such(f"there is no environment {name!r}", name, names(), kind=UnknownTargetError)
    found = candidate.resolve()
    robots.register_robots(found)
    return found


def names() -> list[str]:
    """Return the names of the environments in `envs/` of the working directory, of ours and of installed packages."""
    return sorted({*_in(_PROJECT), *shared_environments()})


def shared_environments() -> dict[str, Path]:
    """Return the folders of environments that any project may use: ours and those of installed packages, by name.

    Raises:
        EntryPointError: one brings an environment whose name another one has.
    """
    found = _in(content.content_folder("envs"))
    origins = dict.fromkeys(found, registry.BUILT_IN_DISTRIBUTION)
    for folder, source in registry.folders(registry.ENVS).items():
        for name, path in _in(folder).items():
            if name in found:
                raise source.unusable(f"{path} and {found[name]} of {origins[name]} are both called {name}")
            found[name], origins[name] = path, source.distribution
    return found


def _in(folder: Path) -> dict[str, Path]:
    return {entry.parent.name: entry.parent for entry in folder.glob(f"*/{_MANIFEST}")}


def manifest(folder: Path) -> EnvManifest:
    """Return what an environment's env.yml says."""
    return EnvManifest.parse(manifests.read(folder / _MANIFEST, package.ENV))


def module(name: str, part: str = "client") -> ModuleType:
    """Load one module of an environment package."""
    return content.load_module(find(name) / f"{part}.py")


def require_simulation(name: str) -> None:
    """Refuse an environment behind which a robot may stand, where nobody asked for an evaluation.

    Raises:
        UserError: with what makes a simulation known as one.
    """
    if manifest(find(name)).is_real:
        raise UserError(
            f"{name} does not say `real_time: false`, so a robot may stand behind it, and this would move it",
            hint="say `real_time: false` in env.yml if it is a simulation; `xpl eval` moves robots",
            code=ExitCode.NOT_RUN,
        )


def make(name: str, config: Config) -> TaskEnv:
    """Return a task environment in this process."""
    made: TaskEnv = content.load_module(_client(find(name))).make(config)
    return made


def start(name: str, config: Config, *, workers: int = 1, python: str | None = None) -> Any:
    """Return a task environment that is safe to drive: where it does not keep its robot's limits, a guard does.

    Args:
        name: the package, or its folder.
        config: configuration, with embodiment, action_type and task.
        workers: processes that share the environments; 0 plays them in this one.
        python: interpreter of the processes.

    Raises:
        UserError: the environment refuses the configuration, or cannot be made or played here.
    """
    from xpl.environment import NotInstalledError
    from xpl.simulator.process import EnvLostError, EnvRaisedError
    from xpl.simulator.worker_pool import EnvTimeouts
    from xpl.vector import VectorEnv

    folder = find(name)
    if not workers and python not in (None, sys.executable):
        raise UserError(f"{name} runs in {python}, and so not in this process: ask for at least one worker")
    try:
        if workers:
            # Where a robot stands, a person puts the scene right: reset waits for that, and is not hung.
            # One that asks for a verdict, too, does so in the last step.
            facts = manifest(folder)
            asks = {"step_s": _PERSON_S} if facts.robot else {}
            limits = EnvTimeouts(start_s=_PERSON_S, **asks) if facts.real_time else None
            env: Any = VectorEnv(_client(folder), config, workers=workers, python=python, limits=limits)
        else:
            env = content.load_module(_client(folder)).make(config)
    except ValueError as error:
        raise UserError(f"{name}: {error}") from None
    except NotInstalledError as error:
        raise UserError(f"{name} cannot be played: {error}", code=ExitCode.NOT_RUN) from None
    except (EnvRaisedError, EnvLostError) as error:
        told = str(error)
        if isinstance(error, EnvRaisedError) and error.kind == NotInstalledError.__name__:
            told = error.message
        raise UserError(f"{name} cannot be played: {told}", code=ExitCode.NOT_RUN) from None
    return env if getattr(env, "guarded", False) else _guarded(env, config, manifest(folder))


def _client(folder: Path) -> Path:
    return folder / manifest(folder).client


def _guarded(env: TaskEnv, config: Config, facts: EnvManifest) -> Any:
    from xpl import get_embodiment
    from xpl.guard import GuardedEnv
    from xpl.safety import Supervisor

    robot, control = get_embodiment(config["embodiment"]), config[sdk.Deploy.ACTION_TYPE]
    rate = facts.frequency(config.get("task"))
    # Unless it is known that the environment waits, it is taken for a robot that does not.
    clock = _stopped if facts.real_time is False else time.monotonic
    return GuardedEnv(env, lambda: Supervisor(robot, control, rate), clock)


def _stopped() -> float:
    """Tell the time of a simulation that waits for the policy, s: no action ages."""
    return 0.0
