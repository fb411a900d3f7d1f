"""Evaluate an adapter in an environment: its own evaluation loop, the real server, one result per episode."""

from __future__ import annotations

import contextlib
import os
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from xpl import Client, agreement, get_embodiment
from xpl import _spec as sdk
from xpl.client import ClientError, EnvironmentMismatchError
from xpl_cli import content, environments, spec
from xpl_cli.errors import ExitCode, NotFoundError, UserError
from xpl_cli.serving.launch import serving

if TYPE_CHECKING:
    import ssl
    from collections.abc import Callable, Mapping
    from contextlib import AbstractContextManager
    from pathlib import Path

    from xpl_cli.package import Package
    from xpl_cli.progress import Progress
    from xpl_cli.serving.launch import RunningServer

ATTEMPTS = 3
INFRASTRUCTURE = "infrastructure"


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
        token, ssl_context: what a server that already runs asks for.
        python, env, gpu: interpreter and device of the adapter.
    """

    package: Package
    environment: str
    task: str | None = None
    episodes: int = 1
    num_envs: int = 1
    overrides: Mapping[str, Any] = field(default_factory=dict)
    connect: str | None = None
    token: str | None = None
    ssl_context: ssl.SSLContext | None = None
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

    A trial that the infrastructure spoils (the server is gone, was restarted or does not answer) says nothing about the
    policy: it is played again, and where that fails, too, it is reported apart and counts neither way.

    Raises:
        UserError: if the environment does not know the task or embodiment, policy and environment do not fit, or the
            policy fails in an episode.
    """
    config = request.package.config(request.overrides)
    settings = environment_settings(request, config)
    loop = load_loop(request.package.path, batch=request.num_envs > 1)
    offer = _offer(request, settings)
    first_seed = int(config[sdk.Deploy.SEED])
    episodes: list[dict[str, Any]] = []
    started = time.perf_counter()
    task_env = environments.make(request.environment, settings)
    with contextlib.closing(task_env), contextlib.closing(_Session(request, config, progress)) as session:
        while len(episodes) < request.episodes:
            seeds = [first_seed + len(episodes) + place for place in range(request.num_envs)]
            episodes += _trial(task_env, seeds, loop, session, offer)
            progress.step(_line(episodes, request.episodes))
    return _report(request, settings, episodes[: request.episodes], time.perf_counter() - started)


def _trial(
    task_env: Any,
    seeds: list[int],
    loop: Callable[[Any, Any], None],
    session: _Session,
    offer: Mapping[str, Any],
) -> list[dict[str, Any]]:
    """Play one trial of every environment, again if the infrastructure spoils it, and return the results."""
    problem: ClientError | None = None
    for _ in range(ATTEMPTS):
        task_env.reset(seed=seeds)
        try:
            loop(task_env, session.client(task_env, offer))
        except ClientError as error:
            text = f"episode with seed {seeds[0]}: {error}"
            if not error.spoils_trial:
                raise UserError(text, code=ExitCode.FINDINGS) from None
            problem = error
            session.drop(text)
        else:
            return [dict(result) for result in task_env.results()]
    spoilt = {"success": None, "score": None, "end_reason": INFRASTRUCTURE, "error": str(problem)}
    return [{sdk.Obs.ENV_IDX: env, sdk.Deploy.SEED: seed, **spoilt} for env, seed in enumerate(seeds)]


def _offer(request: Request, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the environment announces to a policy, but for the inputs, which its observations show."""
    manifest = environments.manifest(environments.find(request.environment))
    return {
        "embodiment": settings["embodiment"],
        sdk.Deploy.ACTION_TYPE: settings[sdk.Deploy.ACTION_TYPE],
        "control_frequency": manifest["control_frequency"],
    }


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


class _Session:
    """A client, and the server it talks to where that is ours; both are made anew after they were dropped."""

    def __init__(self, request: Request, config: Mapping[str, Any], progress: Progress) -> None:
        self._request = request
        self._config = config
        self._progress = progress
        self._stack = contextlib.ExitStack()
        self._client: Client | None = None

    def client(self, task_env: Any, offer: Mapping[str, Any]) -> Client:
        """Return the client; connects, and starts a server, if there is none.

        Args:
            task_env: environment whose observations show which inputs it offers.
            offer: what it announces besides.

        Raises:
            UserError: if there is no server, or policy and environment do not fit.
        """
        if self._client is None:
            request = self._request
            try:
                url = request.connect or self._stack.enter_context(self._serving()).url
                client = Client(
                    url,
                    config=self._config,
                    token=request.token,
                    ssl_context=request.ssl_context,
                    environment={**offer, "inputs": agreement.offered_inputs(task_env.get_obs_batch([0])[0])},
                    on_loading=lambda told: self._progress.step(
                        f"the model is loading: {told.get('seconds', 0):.0f} s"
                    ),
                )
            except EnvironmentMismatchError as error:
                raise UserError(str(error), code=ExitCode.USAGE) from None
            except ClientError as error:
                raise UserError(str(error), code=ExitCode.NOT_RUN) from None
            self._client = self._stack.enter_context(client)
        return self._client

    def _serving(self) -> AbstractContextManager[RunningServer]:
        request = self._request
        return serving(
            request.package.path,
            request.overrides,
            python=request.python,
            env=request.env,
            gpu=request.gpu,
            echo=True,
        )

    def drop(self, reason: str) -> None:
        """Let go of a client that cannot go on, and of its server."""
        self._progress.step(f"{reason}; the trial does not count")
        self.close()

    def close(self) -> None:
        """Close the connection, and end the server where it is ours."""
        self._client = None
        self._stack.close()


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
        "infrastructure_failures": sum(episode.get("end_reason") == INFRASTRUCTURE for episode in episodes),
        "mean_score": sum(float(episode["score"]) for episode in judged) / len(judged) if judged else None,
        "seconds": round(seconds, 3),
    }
