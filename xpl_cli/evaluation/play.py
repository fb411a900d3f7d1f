"""Evaluate an adapter in an environment: a real server, an evaluation loop, one record for each episode.

The loop is the adapter's own (deploy.py), because that is what benchmarks run. With a horizon it is the environment
side's (`xpl.rollout`): how much of a chunk is executed is no business of an adapter.
"""

from __future__ import annotations

import contextlib
import os
import time
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import get_embodiment, rollout
from xpl.action import ActionError
from xpl.client import ClientError
from xpl.simulator.process import EnvLostError, EnvRaisedError
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.evaluation import outcome
from xpl_cli.evaluation.loop.desk import LoopError
from xpl_cli.evaluation.loop.process import Loop
from xpl_cli.evaluation.retries import Schedule, spoilt
from xpl_cli.evaluation.session import Session
from xpl_cli.lifecycle import interpreter
from xpl_cli.packages import environments
from xpl_cli.standard import spec

if TYPE_CHECKING:
    import ssl
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from xpl_cli.basics.progress import Progress
    from xpl_cli.packages.package import Package

ATTEMPTS = 3


@dataclass(frozen=True)
class Request:
    """What to evaluate.

    Attributes:
        package: the adapter.
        environment: name of the environment package.
        task: task of it, its first one by default.
        setting: setting of it, its first one by default.
        episodes: number of episodes.
        num_envs: environments that run at once, in one batch.
        workers: processes that share them; 0 plays them in this process.
        horizon: actions of a chunk that are executed, at most; None leaves the loop to the adapter.
        overrides: keys of deploy.yml.
        connect: address of a server that already runs; one is started otherwise.
        token, ssl_context: what a server that already runs asks for.
        python, env, gpu: interpreter and device of the adapter.
        eval_env: interpreter of the environment, as `interpreter.resolve` takes it; env.yml's or ours by default.
    """

    package: Package
    environment: str
    task: str | None = None
    setting: str | None = None
    episodes: int = 1
    num_envs: int = 1
    workers: int = 1
    horizon: int | None = None
    overrides: Mapping[str, Any] = field(default_factory=dict)
    connect: str | None = None
    token: str | None = None
    ssl_context: ssl.SSLContext | None = None
    python: str | None = None
    env: str | None = None
    gpu: str | None = None
    eval_env: str | None = None


def environment_for(variable: str | None = None) -> str:
    """Return the environment that `EVAL_ENV_TYPE` (or the given value) stands for.

    Raises:
        UserError: if it stands for none here.
    """
    rule = spec.data("package")["eval_env_type"]
    kind = variable or os.environ.get(rule["variable"]) or rule["default"]
    name = rule["values"].get(kind)
    if name is None:
        there = ", ".join(one for one, package in rule["values"].items() if package is not None)
        raise UserError(
            f"{rule['variable']}={kind}: no environment of that kind is here; there are {there}",
            hint="name an environment package with --env",
        )
    return str(name)


def places(num_envs: int | None, workers: str) -> tuple[int, int]:
    """Return how many environments are played at once, and by how many processes.

    Args:
        num_envs: environments, or None for one a process.
        workers: number of processes; 0 for none but this one, "auto" for one a core, as far as there are environments.

    Raises:
        UserError: `workers` is neither, or there are more of them than environments.
    """
    if workers == "auto":
        cores = len(os.sched_getaffinity(0))
        return (cores, cores) if num_envs is None else (num_envs, min(cores, num_envs))
    if not workers.isdecimal():
        raise UserError(f"--workers must be a number or auto, got {workers!r}")
    count = int(workers)
    if num_envs is not None and count > num_envs:
        raise UserError(f"{count} workers for {num_envs} environments: leave --num-envs out, or ask for fewer workers")
    return (max(1, count) if num_envs is None else num_envs), count


def evaluate(request: Request, progress: Progress) -> dict[str, Any]:
    """Run the episodes and return the report `xpl.eval/1`.

    A trial that the infrastructure spoils (the server is gone, was restarted or does not answer; an environment's
    process ended or hangs) says nothing about the policy: it is played again, and where that fails, too, it is reported
    apart and counts neither way.

    Raises:
        UserError: if the environment does not know the task or embodiment or cannot be played, policy and environment
            do not fit, or the policy fails in an episode.
    """
    config = request.package.config(request.overrides)
    settings = environment_settings(request, config)
    folder = environments.find(request.environment)
    facts = environments.manifest(folder)
    offer = {
        "embodiment": settings["embodiment"],
        sdk.Deploy.ACTION_TYPE: settings[sdk.Deploy.ACTION_TYPE],
        "control_frequency": environments.frequency(facts, settings["task"]),
    }
    python = interpreter.resolve(folder, facts, env=request.eval_env)
    first = int(config[sdk.Deploy.SEED])
    schedule = Schedule(range(first, first + request.episodes), request.num_envs, ATTEMPTS)
    started = time.perf_counter()
    task_env = environments.start(request.environment, settings, workers=request.workers, python=python)
    with (
        contextlib.closing(task_env),
        _loop(request) as loop,
        contextlib.closing(Session(request, config, offer, progress)) as session,
    ):
        while not schedule.is_done:
            schedule.add(_trial(task_env, schedule.next(), loop, session))
            progress.step(outcome.line(schedule.results, request.episodes))
    played = {
        "policy": request.package.name,
        "environment": request.environment,
        "task": settings["task"],
        "setting": request.setting or _settings(facts)[0],
        "embodiment": settings["embodiment"],
        sdk.Deploy.ACTION_TYPE: settings[sdk.Deploy.ACTION_TYPE],
        "num_envs": request.num_envs,
        "workers": request.workers,
        "horizon": request.horizon,
    }
    return outcome.report(played, schedule.results, time.perf_counter() - started)


def _trial(task_env: Any, seeds: list[int], loop: Callable[[Any, Any], Any], session: Session) -> list[dict[str, Any]]:
    """Play one trial of every environment and return the results, or those of a trial that was spoilt as a whole."""
    where = f"episode with seed {seeds[0]}" if len(seeds) == 1 else f"episodes with seeds {seeds}"
    try:
        task_env.reset(seed=seeds)
        loop(task_env, session.client(task_env))
    except ClientError as error:
        if not error.spoils_trial:
            raise UserError(f"{where}: {error}", code=ExitCode.FINDINGS) from None
        session.drop(f"{where}: {error}")
        return spoilt(seeds, error)
    except (ActionError, LoopError, ValueError, TypeError, AttributeError) as error:
        raise UserError(f"{where}: {error}", code=ExitCode.FINDINGS) from None
    except EnvLostError as error:
        return spoilt(seeds, error)
    except EnvRaisedError as error:
        raise UserError(f"{where}: the environment raised {error}", code=ExitCode.NOT_RUN) from None
    return [dict(result) for result in task_env.results()]


@contextlib.contextmanager
def _loop(request: Request) -> Iterator[Callable[[Any, Any], Any]]:
    """Give the evaluation loop: the adapter's own, in a process of its own, or with a horizon the environment side's.

    Raises:
        NotFoundError: if it is to be the adapter's and there is none.
        UserError: it cannot be loaded.
    """
    batch = request.num_envs > 1
    if request.horizon is not None:
        yield partial(rollout.run_batch if batch else rollout.run_episode, horizon=request.horizon)
        return
    with contextlib.closing(Loop(request.package.path)) as own:
        try:
            own.load(batch=batch)
        except LoopError as error:
            raise UserError(str(error), code=ExitCode.NOT_RUN) from None
        yield lambda task_env, client: own.play(task_env, rollout.listened(task_env, client), batch=batch)


def environment_settings(request: Request, config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the configuration of the environment for an adapter: task, embodiment, cameras, privileged.

    Raises:
        NotFoundError: if the environment has no such task or setting.
        UserError: if it does not have the embodiment or action type.
    """
    manifest = environments.manifest(environments.find(request.environment))
    tasks = manifest["tasks"]
    task = request.task or config.get(sdk.Deploy.TASK_NAME)
    if task not in tasks and (request.task is not None or request.environment != "offline"):
        if task is not None:
            raise NotFoundError(f"{request.environment} has no task {task!r}; it has {', '.join(tasks)}")
        task = next(iter(tasks))
    robot = get_embodiment(str(config[sdk.Deploy.ENV_CFG_TYPE])).name
    if robot not in manifest["embodiments"]:
        raise UserError(f"{request.environment} has no {robot}; it has {', '.join(manifest['embodiments'])}")
    if request.setting is not None and request.setting not in _settings(manifest):
        raise NotFoundError(
            f"{request.environment} has no setting {request.setting!r}; it has {', '.join(_settings(manifest))}"
        )
    inputs = request.package.manifest.get("inputs")
    wanted = None if inputs is None else [*(inputs.get("required") or ()), *(inputs.get("optional") or ())]
    return {
        "task": task,
        "embodiment": robot,
        sdk.Deploy.ACTION_TYPE: config[sdk.Deploy.ACTION_TYPE],
        "num_envs": request.num_envs,
        "cameras": _cameras(request.package.manifest, wanted, manifest["cameras"]),
        sdk.Obs.PRIVILEGED: wanted is not None and sdk.Obs.PRIVILEGED in wanted,
        **({} if request.setting is None else {"setting": request.setting}),
    }


def _cameras(
    policy: Mapping[str, Any], wanted: Sequence[str] | None, offered: Mapping[str, Any]
) -> bool | tuple[int, int]:
    """Return what an environment is asked to render: nothing, images of its own size, or (height, width).

    Cameras cost most of a step: only who declares them gets them, and who has no manifest. Environments render all
    cameras alike, so that several exact sizes cannot be had: the handshake then says which one is missing.
    """
    if wanted is not None and not any(name.startswith(sdk.Obs.VISION) for name in wanted):
        return False
    needs = [entry for name, entry in (policy.get("cameras") or {}).items() if name in offered]
    height, width = (max((need.get(side) or 0 for need in needs), default=0) for side in ("height", "width"))
    exact = any(need.get("exact") for need in needs)
    own = [(entry["height"], entry["width"]) for entry in offered.values() if entry]
    if not height or not width or (not exact and all(rows >= height and columns >= width for rows, columns in own)):
        return True
    return height, width


def _settings(manifest: Mapping[str, Any]) -> list[str]:
    """Return the settings of an environment, by default the schema's."""
    found: list[str] = manifest.get("settings") or spec.schema("env")["properties"]["settings"]["default"]
    return found
