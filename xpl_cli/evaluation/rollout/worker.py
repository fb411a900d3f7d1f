"""A rollout worker runs episodes one after the other: the environment's side of a run, in whatever process.

It has an environment, in a process and a Python of its own, and a connection to a policy server that is managed
elsewhere. An error of an episode becomes part of its result; an exception ends the run.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import Client, get_embodiment, observation, rollout
from xpl import _spec as sdk
from xpl.action import ActionError
from xpl.client import ClientError, EnvironmentMismatchError, ServerFailedError
from xpl.client.agreement import REAL_TIME
from xpl.simulator.process import EnvLostError, EnvRaisedError
from xpl.vector import INFRASTRUCTURE
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.environments.film import FilmRecorder
from xpl_cli.evaluation.loop.process import AdapterLoop, LoopLostError
from xpl_cli.evaluation.loop.request_handler import LoopError
from xpl_cli.evaluation.records import failures
from xpl_cli.evaluation.records.fingerprints import machine_facts
from xpl_cli.evaluation.records.model import AttemptExecution, now
from xpl_cli.evaluation.rollout import failure_attribution, trial
from xpl_cli.evaluation.rollout.action_check import ActionCheckWrapper
from xpl_cli.evaluation.rollout.backend import RolloutJob, RolloutResult
from xpl_cli.evaluation.rollout.config import EnvSettings, RolloutConfig, ServerAccess
from xpl_cli.evaluation.rollout.instruction import with_instruction
from xpl_cli.evaluation.rollout.scene import (
    InfrastructureError,
    RolloutScene,
    disconnect,
    reset_envs,
    with_short_connect_timeout,
)
from xpl_cli.evaluation.rollout.telemetry import TelemetryWrapper
from xpl_cli.evaluation.rollout.trajectory_recorder import recording
from xpl_cli.lifecycle import interpreter
from xpl_cli.packages import environments
from xpl_cli.serving.secrets import client_tls_context

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.contract import Payload
    from xpl.environment import TaskEnv
    from xpl_cli.evaluation.records.model import EpisodeOutcome


class RolloutWorker:
    """Runs the jobs that it is given.

    Args:
        config: what is run.
        name: of the worker in records.
        access: how to reach policy servers.
    """

    def __init__(self, config: RolloutConfig, name: str, access: ServerAccess | None = None) -> None:
        self._config = config
        self._name = name
        self._access = access or ServerAccess()
        self._tls = None if self._access.ca_file is None else client_tls_context(self._access.ca_file)
        self._env_manifest = environments.manifest(environments.find(config.environment))
        self._robot = get_embodiment(config.settings.embodiment)
        self._machine = machine_facts()
        self._resources = contextlib.ExitStack()
        self._adapter_loop = None if config.horizon is not None else self._make_adapter_loop()
        self._scene: RolloutScene | None = None

    def prepare(self, task: str, setting: str) -> None:
        """Make the environment of a task and setting, and import the adapter's loop, before the first job.

        Raises:
            UserError: the environment refuses its configuration, or cannot run.
        """
        self._load_adapter_loop()
        self._switch_scene(task, setting)

    def run_job(self, job: RolloutJob, url: str) -> RolloutResult:
        """Run an attempt at an episode.

        Args:
            job: the attempt.
            url: of the policy server.

        Raises:
            UserError: nothing can run: the environment refuses its configuration, or the policy does not fit.
        """
        return self.run_jobs([job], url)[0]

    def run_jobs(self, jobs: Sequence[RolloutJob], url: str) -> list[RolloutResult]:
        """Run one attempt at each of several episodes in one batch.

        Args:
            jobs: attempts at episodes of one task and setting, at most one for each environment; the other environments
                run further seeds.
            url: of the policy server.

        Raises:
            UserError: nothing can run, as for `run_job`.
        """
        self._load_adapter_loop()
        started, clock = now(), time.perf_counter()
        watch, outcomes = self._run_jobs(jobs, url)
        took = round(time.perf_counter() - clock, 3)
        containment = self._config.bounds.name
        execution = AttemptExecution(started=started, wall_seconds=took, worker=self._name, containment=containment)
        server = self._server_id()  # None where its connection was let go of
        results = []
        for job, outcome in zip(jobs, outcomes, strict=True):
            if watch is None or outcome.failure == INFRASTRUCTURE:
                results.append(RolloutResult(job, outcome, execution, self._machine, is_server_suspect=True))
                continue
            inference = watch.inference if job is jobs[0] else None  # a batch is answered once for all
            finished = replace(execution, server=server, inference=inference)
            results.append(
                RolloutResult(job, outcome, finished, self._machine, watch.trace(), watch.film(), server is None)
            )
        return results

    def close(self) -> None:
        """End the connection, the environment and the adapter's loop."""
        self._resources.close()
        self._close_scene()

    def _load_adapter_loop(self) -> None:
        """Import the adapter's evaluation loop, if that is what runs.

        Raises:
            NotFoundError: there is no such loop.
            UserError: it cannot be imported.
        """
        if self._adapter_loop is None:
            return
        try:
            self._adapter_loop.load(batch=self._config.num_envs > 1)
        except LoopError as error:
            raise UserError(str(error), code=ExitCode.NOT_RUN) from None

    def _make_adapter_loop(self) -> AdapterLoop:
        """Return the evaluation loop of the adapter, which is imported on demand.

        Raises:
            NotFoundError: there is none.
            UserError: it cannot be isolated.
        """
        policy = Path(self._config.policy)
        with contextlib.ExitStack() as opened:
            loop = AdapterLoop(policy, isolation=opened.enter_context(self._config.bounds.isolate_adapter(policy)))
            opened.callback(loop.close)
            self._resources = opened.pop_all()
        return loop

    def _close_scene(self) -> None:
        """End the connection and the environment."""
        scene, self._scene = self._scene, None
        if scene is not None:
            disconnect(scene)
            scene.env.close()

    def _run_jobs(self, jobs: Sequence[RolloutJob], url: str) -> tuple[TelemetryWrapper | None, list[EpisodeOutcome]]:
        """Return the telemetry, if the rollout began, and the outcome of each job."""
        watch = None
        try:
            scene = self._scene_for(jobs[0])
            reel = FilmRecorder(scene.frequency, scene.camera) if jobs[0].film and scene.camera is not None else None
            env: TaskEnv = ActionCheckWrapper(scene.env, self._robot, self._config.settings.action_type)
            if self._config.instruction is not None:
                env = with_instruction(env, self._config.instruction, jobs, self._config.num_envs)
            with recording(env, self._config, jobs, scene.frequency) as recorder:
                watch = TelemetryWrapper(recorder or env, self._robot, scene.frequency, traced=jobs[0].trace, reel=reel)
                reset_envs(scene.env, jobs, self._config.num_envs)
                try:
                    client = self._connect(scene, url)
                except ServerFailedError as error:
                    return watch, self._failed_outcomes(watch, error, len(jobs))
                outcomes = self._run_trial(watch, client, jobs)
                if recorder is not None:
                    recorder.keep(outcomes)
                return watch, outcomes
        except InfrastructureError as error:
            self._disconnect()
            return watch, [failures.infrastructure_error(str(error))] * len(jobs)

    def _run_trial(self, watch: TelemetryWrapper, client: Client, jobs: Sequence[RolloutJob]) -> list[EpisodeOutcome]:
        """Announce a trial, run it, and report the outcome to the policy.

        Raises:
            InfrastructureError: the trial ended with one.
        """
        case = trial.describe_case(self._settings(jobs[0].task, jobs[0].setting))
        outcomes = self._run_loop(watch, client, len(jobs), case)
        is_connected = self._scene is not None and self._scene.client is not None
        if is_connected and not trial.end(client, outcomes):
            self._disconnect()
        return outcomes

    def _run_loop(self, watch: TelemetryWrapper, client: Client, count: int, case: Payload) -> list[EpisodeOutcome]:
        """Run the loop and return how each episode went.

        Raises:
            InfrastructureError: the infrastructure broke them off.
        """
        config, batch = self._config, self._config.num_envs > 1
        try:
            trial.begin(client, case)
            if self._adapter_loop is not None:
                self._adapter_loop.run_trial(watch, rollout.observed_client(watch, client), batch=batch)
            elif batch:
                rollout.run_batch(watch, client, horizon=config.horizon)
            else:
                rollout.run_episode(watch, client, horizon=config.horizon)
            return [failures.outcome_of(result) for result in watch.results()[:count]]
        except (ClientError, ActionError, LoopError) as error:
            broken: Exception = error
        except (ValueError, TypeError, AttributeError) as error:
            if self._adapter_loop is None:
                raise  # a fault of our own loop
            broken = error
        except (EnvLostError, EnvRaisedError) as error:
            raise InfrastructureError(str(error)) from None
        return self._failed_outcomes(watch, broken, count)

    def _failed_outcomes(self, watch: TelemetryWrapper, error: Exception, count: int) -> list[EpisodeOutcome]:
        """Return how episodes went that the policy's side broke off.

        Raises:
            InfrastructureError: it was not the policy's side.
        """
        scene, results = self._scene, watch.results()[:count]
        url = "" if scene is None or scene.client is None else scene.client[0]
        if failure_attribution.is_policy_crash(error, url, self._tls):
            if not isinstance(error, LoopLostError):
                self._disconnect()
            return [failures.policy_crash(result, str(error)) for result in results]
        if isinstance(error, ClientError) and failure_attribution.is_infrastructure_error(error):
            raise InfrastructureError(str(error))
        return [failures.policy_error(result, str(error)) for result in results]

    def _scene_for(self, job: RolloutJob) -> RolloutScene:
        """Return the scene of a job.

        Raises:
            InfrastructureError: there is none now.
        """
        try:
            return self._switch_scene(job.task, job.setting)
        except UserError as error:
            if error.code != ExitCode.NOT_RUN:
                raise
            raise InfrastructureError(str(error)) from None

    def _switch_scene(self, task: str, setting: str) -> RolloutScene:
        """Return the scene with an environment for a task and setting; a new one where they have changed."""
        if self._scene is not None and self._scene.key == (task, setting):
            return self._scene
        self._close_scene()
        config = self._config
        python = interpreter.resolve(Path(config.environment), self._env_manifest.environment, env=config.eval_env)
        settings = self._settings(task, setting)
        if config.recording is not None and config.recording.privileged:
            if not self._env_manifest.privileged:
                name = Path(config.environment).name
                raise UserError(f"--privileged: {name} has no privileged observations (`privileged` in env.yml)")
            settings = replace(settings, privileged=True)
        env = environments.start(config.environment, settings.as_config(), workers=config.env_workers, python=python)
        names = list(self._env_manifest.cameras)
        camera = next((name for name in sdk.OPTIONAL_CAMERAS if name in names), next(iter(names), None))
        self._scene = RolloutScene((task, setting), env, self._env_manifest.frequency(task), camera)
        return self._scene

    def _settings(self, task: str, setting: str) -> EnvSettings:
        """Return the settings of the environment for a task and setting."""
        return replace(self._config.settings, task=task, setting=setting, num_envs=self._config.num_envs)

    def _connect(self, scene: RolloutScene, url: str) -> Client:
        """Return a client of the policy server, connected for this scene.

        Raises:
            UserError: policy and environment do not fit.
            ServerFailedError: the policy's process ended.
            InfrastructureError: there is no connection.
        """
        if scene.client is not None and scene.client[0] == url:
            return scene.client[1]
        disconnect(scene)
        settings = self._config.settings
        offer = {
            "embodiment": settings.embodiment,
            sdk.Deploy.ACTION_TYPE: settings.action_type,
            "control_frequency": scene.frequency,
            **({REAL_TIME: True} if self._env_manifest.real_time else {}),
        }
        access, config = self._access, failure_attribution.with_longer_timeout(self._config.config)
        try:
            obs = scene.env.get_obs_batch([0])[0]
            client = Client(
                url,
                config=config if access.is_patient else with_short_connect_timeout(config),
                token=access.token,
                ssl_context=self._tls,
                environment={
                    **offer,
                    "inputs": observation.offered_inputs(obs),
                    "cameras": observation.offered_cameras(obs),
                },
                on_loading=access.on_loading,
            )
        except EnvironmentMismatchError as error:
            raise UserError(str(error), code=ExitCode.USAGE) from None
        except EnvLostError as error:
            raise InfrastructureError(str(error)) from None
        except ServerFailedError:
            raise
        except ClientError as error:
            if error.is_infrastructure_error:
                raise InfrastructureError(str(error)) from None
            raise UserError(str(error), code=ExitCode.NOT_RUN) from None
        scene.client = url, client
        return client

    def _server_id(self) -> str | None:
        scene = self._scene
        return None if scene is None or scene.client is None else scene.client[1].server_instance_id

    def _disconnect(self) -> None:
        """Let go of a connection that may not be able to go on; an environment that was lost starts itself again."""
        if self._scene is not None:
            disconnect(self._scene)
