"""Record episodes as trajectories: the observations of the policy and its actions.

The recorder stands between an evaluation loop and its environment, as `TelemetryWrapper` does, and changes nothing. A
file appears once its episode has ended and is to be saved; an episode that breaks off leaves nothing.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import trajectory
from xpl_cli import __version__
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.environments.rollout import choose_name
from xpl_cli.evaluation.records.model import now
from xpl_cli.evaluation.rollout.config import ALL, KEEP, RecordingConfig
from xpl_cli.evaluation.rollout.env_wrapper import TaskEnvWrapper

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl.contract import Action, ObservationDict
    from xpl.environment import TaskEnv
    from xpl_cli.evaluation.records.model import EpisodeOutcome
    from xpl_cli.evaluation.rollout.backend import RolloutJob
    from xpl_cli.evaluation.rollout.config import RolloutConfig


def file_name(index: int) -> str:
    """Return the name of an episode's file, by its place in the plan."""
    return f"episode_{index:07d}.hdf5"


def is_kept(outcome: EpisodeOutcome, keep: str) -> bool:
    """Return whether an episode is to be saved."""
    return outcome.failure in (None, "task") and (keep == ALL or bool(outcome.success))


@contextlib.contextmanager
def recording(
    task_env: TaskEnv, config: RolloutConfig, jobs: Sequence[RolloutJob], frequency: float
) -> Iterator[TrajectoryRecorder | None]:
    """Yield a wrapper that records the episodes of an environment; None if nothing is recorded.

    Args:
        task_env: the environment.
        config: of the rollout.
        jobs: the attempt of each environment.
        frequency: control rate, Hz.
    """
    if config.recording is None:
        yield None
        return
    recorder = TrajectoryRecorder(task_env, config, jobs, frequency)
    try:
        yield recorder
    finally:
        recorder.close()


class TrajectoryRecorder(TaskEnvWrapper):
    """A task environment whose episodes are recorded; see `recording`."""

    def __init__(self, task_env: TaskEnv, config: RolloutConfig, jobs: Sequence[RolloutJob], frequency: float) -> None:
        assert config.recording is not None  # noqa: S101 - for the type checker: `recording` checks
        super().__init__(task_env)
        self._config, self._settings, self._jobs = config, config.recording, list(jobs)
        self._frequency = frequency
        self._hides = config.recording.privileged and not config.settings.privileged
        self._observations: dict[int, ObservationDict] = {}
        self._has_inferred = False
        self._error: Exception | None = None
        self._writers: dict[int, trajectory.Writer] = {}

    def keep(self, outcomes: Sequence[EpisodeOutcome]) -> None:
        """Commit the files of the episodes that are to be saved.

        Args:
            outcomes: how each ended, in the order of the jobs.

        Raises:
            UserError: one could not be written.
        """
        try:
            if self._error is not None:
                raise self._error
            for env, (job, outcome) in enumerate(zip(self._jobs, outcomes, strict=True)):
                writer = self._writers.get(env)
                if writer is not None and is_kept(outcome, self._settings.keep):
                    writer.episode = self._metadata(job, outcome)
                    del self._writers[env]
                    writer.commit()
        except (trajectory.TrajectoryError, ImportError) as error:
            raise UserError(f"episodes cannot be recorded: {error}", code=ExitCode.NOT_RUN) from None

    def close(self) -> None:
        """Discard the files that are not saved."""
        for writer in self._writers.values():
            writer.discard()
        self._writers = {}

    def _on_observation(self, env: int, obs: ObservationDict) -> ObservationDict:
        """Return an observation as the policy gets it: without values that only the file holds."""
        self._observations[env] = obs
        return {key: value for key, value in obs.items() if key != sdk.Obs.PRIVILEGED} if self._hides else obs

    def _before_step(self, actions: Sequence[Action], envs: Sequence[int]) -> None:
        for env, action in zip(envs, actions, strict=False):
            self._add(env, action)
        self._has_inferred = False

    def _on_inference(self, seconds: float) -> None:  # noqa: ARG002 - a file has the step, not the duration
        self._has_inferred = True

    def _add(self, env: int, action: Action) -> None:
        """Add a step. What goes wrong is raised at the end: a loop would take it for a fault of the policy."""
        if self._error is not None or env >= len(self._jobs) or env not in self._env.get_running_env_idx_list():
            return
        obs = self._observations.pop(env, None)
        if obs is None:  # a loop that executes a chunk without looking
            obs = self._env.get_obs_batch([env])[0]
        try:
            if env not in self._writers:
                self._writers[env] = self._writer(self._jobs[env])
            recorded_obs = obs if self._settings.depth else _without_depth(obs)
            self._writers[env].add(recorded_obs, action, asked=self._has_inferred)
        except (trajectory.TrajectoryError, ImportError) as error:
            self._error = error

    def _writer(self, job: RolloutJob) -> trajectory.Writer:
        path = Path(self._settings.folder) / file_name(job.index)
        recording = self._settings
        return trajectory.Writer(
            path,
            images=recording.images,
            quality=recording.quality,
            frequency=self._frequency,
            privileged=recording.privileged,
        )

    def _metadata(self, job: RolloutJob, outcome: EpisodeOutcome) -> dict[str, Any]:
        """Return the metadata of an episode: what ran with which policy, and how it ended."""
        config = self._config
        return {
            "environment": Path(config.environment).name,
            "environment_digest": config.environment_digest,
            "task": job.task,
            "setting": job.setting,
            sdk.Deploy.SEED: job.seed,
            "robot": config.settings.embodiment,
            sdk.Deploy.ACTION_TYPE: config.settings.action_type,
            "policy": Path(config.policy).name,
            "policy_digest": config.policy_digest,
            **{name: getattr(outcome, name) for name in ("success", "score", "end_reason")},
            **{
                name: value
                for name in ("steps", "corrections", "digest")
                if (value := getattr(outcome, name)) is not None
            },
            "recorded": now(),
            "writer": f"xpl {__version__}",
        }


def _without_depth(obs: ObservationDict) -> ObservationDict:
    vision = {
        name: {key: value for key, value in camera.items() if key != sdk.Camera.DEPTH}
        for name, camera in (obs.get(sdk.Obs.VISION) or {}).items()
    }
    return {**obs, sdk.Obs.VISION: vision}


def recording_config(
    folder: Path | None, keep: str | None, *, resume: bool, privileged: bool
) -> RecordingConfig | None:
    """Return where an evaluation saves trajectories; None if none were requested.

    Args:
        folder: of the set; None for no recording.
        keep: one of `KEEP`; all by default.
        resume: whether an existing set is continued.
        privileged: whether to save privileged observations.

    Raises:
        UserError: there are episodes already, an option is unknown or needs --record, or h5py is not installed.
    """
    if folder is None:
        if keep is not None:
            raise UserError("--keep selects which episodes --record saves: add --record")
        if privileged:
            raise UserError("--privileged selects what --record saves: add --record")
        return None
    require_library()
    if not resume and next(folder.glob("*.hdf5"), None) is not None:
        raise UserError(f"{folder} holds trajectories already", hint="choose another --record, or go on with --resume")
    return RecordingConfig(
        str(folder.absolute()), choose_name("choice for --keep", keep or ALL, KEEP), privileged=privileged
    )


def require_library() -> None:
    """Raise where trajectories cannot be written at all.

    Raises:
        UserError: h5py is not installed.
    """
    from xpl.trajectory.storage import hdf5
    from xpl_cli.basics.extras import how_to_install

    try:
        hdf5()
    except ImportError as error:
        raise UserError(str(error), hint=how_to_install("data"), code=ExitCode.NOT_RUN) from None
