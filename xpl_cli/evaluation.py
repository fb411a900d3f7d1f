"""Evaluate an adapter in an environment: its own evaluation loop, the real server, one result per episode."""

from __future__ import annotations

import contextlib
import os
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from xpl import Client, get_embodiment
from xpl import _spec as sdk
from xpl.client import ClientError
from xpl_cli import content, environments, spec
from xpl_cli.errors import ExitCode, NotFoundError, UserError
from xpl_cli.serving.launch import serving

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from xpl_cli.package import Package
    from xpl_cli.progress import Progress


@dataclass(frozen=True)
class Request:
    """What to evaluate.

    Attributes:
        package: the adapter.
        environment: name of the environment package.
        task: task of it, its first one by default.
        episodes: number of episodes.
        num_envs: environments that run at once, in one batch.
        overrides: keys of deploy.yml.
        connect: address of a server that already runs; one is started otherwise.
        python, env, gpu: interpreter and device of the adapter.
    """

    package: Package
    environment: str
    task: str | None = None
    episodes: int = 1
    num_envs: int = 1
    overrides: Mapping[str, Any] = field(default_factory=dict)
    connect: str | None = None
    python: str | None = None
    env: str | None = None
    gpu: str | None = None


def environment_for(variable: str | None = None) -> str:
    """Return the environment that `EVAL_ENV_TYPE` (or the given value) stands for.

    Raises:
        UserError: if it stands for none here.
    """
    rule = spec.data("package")["eval_env_type"]
    kind = variable or os.environ.get(rule["variable"]) or rule["default"]
    name = rule["values"].get(kind)
    if name is None:
        raise UserError(
            f"{rule['variable']}={kind}: no environment of that kind is here; there are {', '.join(rule['values'])}",
            hint="name an environment package with --env",
        )
    return str(name)


def evaluate(request: Request, progress: Progress) -> dict[str, Any]:
    """Run the episodes and return the report `xpl.eval/1`.

    Raises:
        UserError: if the environment does not know the task or embodiment, or the policy fails in an episode.
    """
    config = request.package.config(request.overrides)
    settings = environment_settings(request, config)
    loop = load_loop(request.package.path, batch=request.num_envs > 1)
    first_seed = int(config[sdk.Deploy.SEED])
    episodes: list[dict[str, Any]] = []
    started = time.perf_counter()
    task_env = environments.make(request.environment, settings)
    with contextlib.closing(task_env), _connected(request, config) as client:
        while len(episodes) < request.episodes:
            seeds = [first_seed + len(episodes) + place for place in range(request.num_envs)]
            task_env.reset(seed=seeds)
            try:
                loop(task_env, client)
            except ClientError as error:
                raise UserError(f"episode with seed {seeds[0]}: {error}", code=ExitCode.FINDINGS) from None
            episodes += [dict(result) for result in task_env.results()]
            progress.step(_line(episodes, request.episodes))
    return _report(request, settings, episodes[: request.episodes], time.perf_counter() - started)


def environment_settings(request: Request, config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the configuration of the environment for an adapter: task, embodiment, cameras, privileged.

    Raises:
        NotFoundError: if the environment has no such task.
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
    inputs = request.package.manifest.get("inputs")
    wanted = None if inputs is None else [*(inputs.get("required") or ()), *(inputs.get("optional") or ())]
    return {
        "task": task,
        "embodiment": robot,
        sdk.Deploy.ACTION_TYPE: config[sdk.Deploy.ACTION_TYPE],
        "num_envs": request.num_envs,
        # Cameras cost most of a step: only who declares them gets them, and who has no manifest.
        "cameras": wanted is None or any(name.startswith(sdk.Obs.VISION) for name in wanted),
        sdk.Obs.PRIVILEGED: wanted is not None and sdk.Obs.PRIVILEGED in wanted,
    }


def load_loop(policy_dir: Path, *, batch: bool) -> Callable[[Any, Any], None]:
    """Return the evaluation loop of an adapter's deploy.py.

    Raises:
        NotFoundError: if it has none.
    """
    single, batched = spec.data("package")["loop"]["functions"]
    name = batched if batch else single
    path = policy_dir / sdk.File.DEPLOY_PY
    if not path.is_file():
        raise NotFoundError(f"{policy_dir} has no deploy.py")
    loop = getattr(content.load_module(path), name, None)
    if loop is None:
        raise NotFoundError(f"{path} has no function {name}")
    found: Callable[[Any, Any], None] = loop
    return found


@contextlib.contextmanager
def _connected(request: Request, config: Mapping[str, Any]) -> Iterator[Client]:
    with contextlib.ExitStack() as stack:
        url = request.connect
        if url is None:
            server = serving(
                request.package.path,
                request.overrides,
                python=request.python,
                env=request.env,
                gpu=request.gpu,
                echo=True,
            )
            url = stack.enter_context(server).url
        try:
            client = Client(url, config=config)
        except ClientError as error:
            raise UserError(str(error), code=ExitCode.NOT_RUN) from None
        yield stack.enter_context(client)


def _tally(episodes: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], int]:
    """Return the episodes that have a success to speak of, and how many of them succeeded."""
    judged = [episode for episode in episodes if episode.get("success") is not None]
    return judged, sum(bool(episode["success"]) for episode in judged)


def _line(episodes: list[dict[str, Any]], total: int) -> str:
    judged, won = _tally(episodes)
    said = f", {won} of {len(judged)} succeeded" if judged else ""
    return f"episode {min(len(episodes), total)} of {total}{said}"


def _report(
    request: Request, settings: Mapping[str, Any], episodes: list[dict[str, Any]], seconds: float
) -> dict[str, Any]:
    judged, won = _tally(episodes)
    return {
        "schema": "xpl.eval/1",
        "policy": request.package.name,
        "environment": request.environment,
        "task": settings["task"],
        "embodiment": settings["embodiment"],
        sdk.Deploy.ACTION_TYPE: settings[sdk.Deploy.ACTION_TYPE],
        "episodes": episodes,
        "successes": won if judged else None,
        "success_rate": won / len(judged) if judged else None,
        "mean_score": sum(float(episode["score"]) for episode in judged) / len(judged) if judged else None,
        "seconds": round(seconds, 3),
    }
