"""What an environment is configured with for an adapter: task, robot, cameras, privileged observations."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import get_embodiment, robots
from xpl_cli.basics.errors import NotFoundError, UserError
from xpl_cli.evaluation.rollout.config import EnvSettings
from xpl_cli.packages import environments
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl.contract import Config
    from xpl.manifest import Manifest
    from xpl_cli.packages.package import Package


def environment_for() -> str:
    """Return the environment of `EVAL_ENV_TYPE`.

    Raises:
        UserError: there is none for its value.
    """
    rule = spec.data("package")["eval_env_type"]
    kind = os.environ.get(rule["variable"]) or rule["default"]
    name = rule["values"].get(kind)
    if name is None:
        offered = ", ".join(one for one, package in rule["values"].items() if package is not None)
        raise UserError(
            f"{rule['variable']}={kind}: no environment of that kind is here; there are {offered}",
            hint="name an environment package with --env",
        )
    return str(name)


def benchmark_for(config: Config) -> str | None:
    """Return the environment of the benchmark in deploy.yml, if one here has its task; None if not.

    Launchers of the ecosystem set the benchmark by `bench_name`. `EVAL_ENV_TYPE` takes precedence if it is anything but
    a simulation.
    """
    rule = spec.data("package")["eval_env_type"]
    bench, task = config.get(sdk.Deploy.BENCH_NAME), config.get(sdk.Deploy.TASK_NAME)
    if bench is None or (os.environ.get(rule["variable"]) or rule["default"]) != rule["default"]:
        return None
    for name in environments.names():
        facts = environments.manifest(environments.find(name))
        hand_over = facts.hand_over
        if hand_over is not None and hand_over.bench_name.lower() == str(bench).lower() and task in facts.tasks:
            return name
    return None


def with_robot(package: Package, environment: str, overrides: Config) -> Config:
    """Return overrides with the first robot of policy.yml that the environment supports, if none is configured.

    Args:
        package: the adapter.
        environment: name of the environment package, or its folder.
        overrides: keys of deploy.yml.
    """
    key, declared = sdk.Deploy.ENV_CFG_TYPE, package.manifest.embodiments
    if {overrides.get(key), package.deploy.get(key)} == {None} and declared:
        facts = environments.manifest(environments.find(environment))
        both = [robot for robot in declared if facts.offers(robots.canonical(robot) or robot)]
        if both and both[0] != declared[0]:
            return {**overrides, key: both[0]}
    return dict(overrides)


def environment_settings(  # noqa: PLR0913 - by keyword, how one scene differs from another
    package: Package,
    environment: str,
    config: Config,
    *,
    task: str | None = None,
    setting: str | None = None,
    num_envs: int = 1,
) -> EnvSettings:
    """Return the settings of the environment for an adapter.

    Args:
        package: the adapter.
        environment: name of the environment package, or its folder.
        config: the adapter's configuration.
        task: task of the environment; deploy.yml's or its first one by default.
        setting: setting of it; left out of the configuration by default.
        num_envs: environments in one batch.

    Raises:
        NotFoundError: the environment has no such task or setting.
        UserError: environment or adapter does not support the embodiment or action type.
    """
    manifest = environments.manifest(environments.find(environment))
    tasks = manifest.tasks
    configured = config.get(sdk.Deploy.TASK_NAME)
    task, is_asked_for = task or configured, task not in (None, configured)
    if task not in tasks and (is_asked_for or not manifest.scripted):  # launchers debug with the benchmark's task
        if task is not None:
            raise NotFoundError(f"{environment} has no task {task!r}; it has {', '.join(tasks)}")
        task = next(iter(tasks))
    robot = get_embodiment(str(config[sdk.Deploy.ENV_CFG_TYPE])).name
    if not manifest.offers(robot):
        raise UserError(f"{environment} has no {robot}; it has {', '.join(manifest.embodiments)}")
    package.require_declared(config)
    offered = manifest.settings
    if setting is not None and setting not in offered:
        raise NotFoundError(f"{environment} has no setting {setting!r}; it has {', '.join(offered)}")
    inputs = package.manifest.inputs
    inputs_read = None if inputs is None else inputs.read
    return EnvSettings(
        task=task,
        embodiment=robot,
        action_type=config[sdk.Deploy.ACTION_TYPE],
        num_envs=num_envs,
        cameras=_cameras(package.manifest, inputs_read, manifest.cameras),
        privileged=inputs_read is not None and sdk.Obs.PRIVILEGED in inputs_read,
        setting=setting,
    )


def _cameras(policy: Manifest, inputs_read: Sequence[str] | None, offered: Mapping[str, Any]) -> bool | tuple[int, int]:
    """Return what an environment renders: False for nothing, True for images of its own size, or (height, width).

    Cameras cost most of a step: only adapters that declare them get them, and adapters without a manifest. Environments
    render all cameras alike, so that several exact sizes are impossible: the handshake then reports which one is
        missing.
    """
    if inputs_read is not None and not any(name.startswith(sdk.Obs.VISION) for name in inputs_read):
        return False
    needs = [entry for name, entry in policy.cameras.items() if name in offered]
    height = max((need.height or 0 for need in needs), default=0)
    width = max((need.width or 0 for need in needs), default=0)
    exact = any(need.exact for need in needs)
    own = [(entry["height"], entry["width"]) for entry in offered.values() if entry]
    if not height or not width or (not exact and all(rows >= height and columns >= width for rows, columns in own)):
        return True
    return height, width
