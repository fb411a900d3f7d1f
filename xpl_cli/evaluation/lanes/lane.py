"""A lane plays episodes, one after the other: the environment's side of a run, in whatever process it is put.

It has an environment, in a process and a Python of its own, and a connection to a policy server that somebody else
looks after. What goes wrong in an episode becomes a part of its outcome; what is raised ends the run.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import Client, get_embodiment, observation, rollout
from xpl import _spec as sdk
from xpl.action import ActionError
from xpl.client import ClientError, EnvironmentMismatchError, ServerFailedError
from xpl.simulator.process import EnvLostError, EnvRaisedError
from xpl.vector import INFRASTRUCTURE
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.environments.film import Reel
from xpl_cli.evaluation.lanes import blame
from xpl_cli.evaluation.lanes.backend import Job, Outcome
from xpl_cli.evaluation.lanes.watch import Watch
from xpl_cli.evaluation.loop.desk import LoopError
from xpl_cli.evaluation.loop.process import Loop, LoopLostError
from xpl_cli.evaluation.records import failures
from xpl_cli.evaluation.records.fingerprints import machine_facts
from xpl_cli.evaluation.records.records import now
from xpl_cli.lifecycle import interpreter
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from xpl_cli.evaluation.records.records import Line

_CONNECT_S, _AGAIN_S = 5.0, 0.2


@dataclass(frozen=True)
class Orders:
    """What all lanes of a run play; everything in it may travel to another machine.

    Attributes:
        policy: folder of the adapter, whose loop is run where there is no horizon.
        policy_digest: of its own files.
        environment: folder of the environment package.
        environment_digest: of its own files.
        config: the adapter's configuration.
        settings: configuration of the environment, but for task and setting.
        horizon: actions of a chunk that are executed, at most; None leaves the loop to the adapter.
        eval_env: Python of the environment, as `interpreter.resolve` takes it; None is env.yml's, or ours.
    """

    policy: str
    policy_digest: str
    environment: str
    environment_digest: str
    config: Mapping[str, Any]
    settings: Mapping[str, Any]
    horizon: int | None = None
    eval_env: str | None = None


@dataclass
class _Scene:
    """What is being played: a task in a setting, and who answers for the policy.

    Attributes:
        key: task and setting.
        env: the environment.
        frequency: control rate, Hz.
        camera: films it; None: it has no camera.
        client: connection to a policy server, with its address; None where there is none yet.
    """

    key: tuple[str, str]
    env: Any
    frequency: float
    camera: str | None
    client: tuple[str, Client] | None = field(default=None)


class Lane:
    """Plays the jobs that it is given.

    Args:
        orders: what is played.
        worker: name of the lane in records.
        token: bearer token of the policy servers, where they ask for one.
    """

    def __init__(self, orders: Orders, worker: str, token: str | None = None) -> None:
        self._orders = orders
        self._worker = worker
        self._token = token
        self._robot = get_embodiment(orders.settings["embodiment"])
        self._facts = environments.manifest(Path(orders.environment))
        self._machine = machine_facts()
        self._own = None if orders.horizon is not None else _own_loop(Path(orders.policy))
        self._scene: _Scene | None = None

    def play(self, job: Job, url: str) -> Outcome:
        """Play an attempt at an episode.

        Args:
            job: the attempt.
            url: of the policy server.

        Raises:
            UserError: nothing can be played: the environment refuses its configuration, or the policy does not fit.
        """
        started, clock = now(), time.perf_counter()
        watch, line = self._played(job, url)
        told = {"started": started, "wall_seconds": round(time.perf_counter() - clock, 3), "worker": self._worker}
        if watch is None or line["failure"] == INFRASTRUCTURE:
            return Outcome(job, {**line, **told}, self._machine, is_server_suspect=True)
        server = self._server()  # None where its connection was let go of
        told |= {"inference": watch.inference, "server": server}
        return Outcome(job, {**line, **told}, self._machine, watch.trace(), watch.film(), server is None)

    def close(self) -> None:
        """End the connection, the environment and the adapter's loop."""
        if self._own is not None:
            self._own.close()
        self._leave()

    def _leave(self) -> None:
        """End the connection and the environment."""
        scene, self._scene = self._scene, None
        if scene is not None:
            _hang_up(scene)
            scene.env.close()

    def _played(self, job: Job, url: str) -> tuple[Watch | None, Line]:
        """Return who looked on, if it came to that, and what is recorded of the outcome."""
        watch = None
        try:
            scene = self._set(job.task, job.setting)
            reel = Reel(scene.frequency, scene.camera) if job.film and scene.camera is not None else None
            watch = Watch(scene.env, self._robot, scene.frequency, traced=job.trace, reel=reel)
            _reset(scene.env, job)
            try:
                client = self._connected(scene, url)
            except ServerFailedError as error:
                return watch, self._failed(watch, error)
            return watch, self._judged(watch, client)
        except _SpoiltError as error:
            self._drop()
            return watch, failures.spoilt(str(error))

    def _judged(self, watch: Watch, client: Client) -> Line:
        """Run the loop and return how the episode went.

        Raises:
            _SpoiltError: the infrastructure broke it off.
        """
        try:
            if self._own is None:
                rollout.run_episode(watch, client, horizon=self._orders.horizon)
            else:
                self._own.play(watch, rollout.listened(watch, client), batch=False)
            return failures.played(watch.results()[0])
        except (ClientError, ActionError, LoopError) as error:
            broken: Exception = error
        except (ValueError, TypeError, AttributeError) as error:
            if self._own is None:
                raise  # a fault of our own loop
            broken = error
        except (EnvLostError, EnvRaisedError) as error:
            raise _SpoiltError(str(error)) from None
        return self._failed(watch, broken)

    def _failed(self, watch: Watch, error: Exception) -> Line:
        """Return how an episode went that the policy's side broke off.

        Raises:
            _SpoiltError: it was not the policy's side.
        """
        scene = self._scene
        if blame.is_death(error, "" if scene is None or scene.client is None else scene.client[0]):
            if not isinstance(error, LoopLostError):
                self._drop()
            return failures.died(watch.results()[0], str(error))
        if isinstance(error, ClientError) and blame.is_outside(error):
            raise _SpoiltError(str(error))
        return failures.failed(watch.results()[0], str(error))

    def _set(self, task: str, setting: str) -> _Scene:
        """Return the scene with an environment for a task and setting; a new one where they have changed."""
        if self._scene is not None and self._scene.key == (task, setting):
            return self._scene
        self._leave()
        orders = self._orders
        folder = Path(orders.environment)
        try:
            python = interpreter.resolve(folder, self._facts, env=orders.eval_env)
            config = {**orders.settings, "task": task, "setting": setting}
            env = environments.start(orders.environment, config, python=python)
        except UserError as error:
            if error.code != ExitCode.NOT_RUN:
                raise
            raise _SpoiltError(str(error)) from None
        names = list(self._facts["cameras"])
        camera = next((name for name in sdk.OPTIONAL_CAMERAS if name in names), next(iter(names), None))
        self._scene = _Scene((task, setting), env, environments.frequency(self._facts, task), camera)
        return self._scene

    def _connected(self, scene: _Scene, url: str) -> Client:
        """Return a client of the policy server, connected for this scene.

        Raises:
            UserError: policy and environment do not fit.
            ServerFailedError: the policy's process ended.
            _SpoiltError: there is no connection.
        """
        if scene.client is not None and scene.client[0] == url:
            return scene.client[1]
        _hang_up(scene)
        settings = self._orders.settings
        offer = {
            "embodiment": settings["embodiment"],
            sdk.Deploy.ACTION_TYPE: settings[sdk.Deploy.ACTION_TYPE],
            "control_frequency": scene.frequency,
        }
        try:
            offer["inputs"] = observation.offered_inputs(scene.env.get_obs_batch([0])[0])
            client = Client(url, config=_impatient(self._orders.config), token=self._token, environment=offer)
        except EnvironmentMismatchError as error:
            raise UserError(str(error), code=ExitCode.USAGE) from None
        except EnvLostError as error:
            raise _SpoiltError(str(error)) from None
        except ServerFailedError:
            raise
        except ClientError as error:
            if error.spoils_trial:
                raise _SpoiltError(str(error)) from None
            raise UserError(str(error), code=ExitCode.NOT_RUN) from None
        scene.client = url, client
        return client

    def _server(self) -> str | None:
        scene = self._scene
        return None if scene is None or scene.client is None else scene.client[1].server_instance_id

    def _drop(self) -> None:
        """Let go of a connection that may not be able to go on; an environment that was lost starts itself again."""
        if self._scene is not None:
            _hang_up(self._scene)


class _SpoiltError(Exception):
    """The infrastructure broke an attempt off."""


def _own_loop(policy: Path) -> Loop:
    """Return the evaluation loop of an adapter, which can be played.

    Raises:
        NotFoundError: there is none.
        UserError: it cannot be loaded.
    """
    loop = Loop(policy)
    try:
        loop.load(batch=False)
    except LoopError as error:
        raise UserError(str(error), code=ExitCode.NOT_RUN) from None
    return loop


def _impatient(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration for a client that soon gives up on a server that is gone.

    Whoever leads the run starts servers before lanes need them, and again when they have ended. A lane waits as long
    as a place on the server may be kept for a client that was cut off, and a little more.
    """
    kept = config.get(sdk.Deploy.CLOSE_TIMEOUT_S)
    kept = sdk.DEPLOY_DEFAULTS[sdk.Deploy.CLOSE_TIMEOUT_S] if kept is None else kept
    return {**config, sdk.Deploy.MAX_CONNECT_SECONDS: kept + _CONNECT_S, sdk.Deploy.CONNECT_RETRY_DELAY_S: _AGAIN_S}


def _reset(env: Any, job: Job) -> None:
    """Begin an episode.

    Raises:
        UserError: the environment refuses the seed.
        _SpoiltError: it raised something else, or is lost.
    """
    try:
        env.reset(seed=[job.seed])
    except ValueError as error:
        raise UserError(f"{job.task}, {job.setting}, seed {job.seed}: {error}") from None
    except EnvRaisedError as error:
        raise _SpoiltError(f"the environment raised {error}") from None
    except EnvLostError as error:
        raise _SpoiltError(str(error)) from None


def _hang_up(scene: _Scene) -> None:
    if scene.client is not None:
        with contextlib.suppress(ClientError, OSError):
            scene.client[1].close()
        scene.client = None
