"""Trajectories that are recorded during rollouts: every step with its observation, and only whole episodes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from xpl import rollout, trajectory
from xpl_cli.basics.errors import UserError
from xpl_cli.evaluation.records.model import EpisodeOutcome
from xpl_cli.evaluation.rollout.backend import RolloutJob
from xpl_cli.evaluation.rollout.config import ALL, SUCCESS, EnvSettings, RecordingConfig, RolloutConfig
from xpl_cli.evaluation.rollout.trajectory_recorder import recording

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

STATE = ("arm_joint_state", "ee_joint_state")


class Counting:
    """Environments whose state is the number of their step, and that end after a given number of steps."""

    guarded = True

    def __init__(self, *ends: int) -> None:
        self._ends, self._steps = ends, [0] * len(ends)
        self.seen = 0

    def get_obs(self) -> dict[str, Any]:
        return self.get_obs_batch([0])[0]

    def get_obs_batch(self, env_idx_list: Sequence[int] | None = None, last_frame: bool = False) -> list[Any]:
        chosen = self.get_running_env_idx_list() if env_idx_list is None else env_idx_list
        self.seen += len(chosen)
        state = [{name: np.full(1, self._steps[env], np.float32) for name in STATE} for env in chosen]
        return [{"state": one, "privileged": {"truth": 1.0}} for one in state]

    def take_action(self, action: Mapping[str, Any]) -> None:
        self.take_action_batch([action], [0])

    def take_action_batch(self, actions: Sequence[Any], env_idx_list: Sequence[int]) -> None:
        for env in env_idx_list:
            self._steps[env] += 1

    def get_running_env_idx_list(self) -> list[int]:
        return [env for env, end in enumerate(self._ends) if self._steps[env] < end]

    def is_episode_end(self) -> bool:
        return not self.get_running_env_idx_list()

    def results(self) -> list[dict[str, Any]]:
        return [{} for _ in self._ends]


class Chunks:
    """A policy that answers with chunks of three actions, which count on from one call to the next."""

    def __init__(self) -> None:
        self.count = 0

    def call(self, func_name: str, obs: Any = None) -> Any:
        if not func_name.startswith("get_action"):
            return None
        chunks = []
        for _ in obs if isinstance(obs, list) else [0]:
            chunks.append([{name: [self.count + step] for name in STATE} for step in range(3)])
            self.count += 3
        return chunks if isinstance(obs, list) else chunks[0]


def _config(folder: Path, keep: str = ALL, **options: bool) -> RolloutConfig:
    settings = EnvSettings("lift", "arx_x5", "joint", **options)
    demos = RecordingConfig(str(folder), keep, privileged="privileged" in options)
    return RolloutConfig("policy/P", "1" * 64, "envs/E", "2" * 64, {}, settings, recording=demos)


def _line(*, success: bool = True, failure: str | None = None) -> EpisodeOutcome:
    return EpisodeOutcome(success=success, failure=failure, steps=4, score=float(success), end_reason="success")


def _job(index: int) -> RolloutJob:
    return RolloutJob(index, 1, "lift", "clean", 100 + index)


def test_every_step_has_what_was_seen_before_it_also_inside_a_chunk(tmp_path: Path) -> None:
    """A loop that does not observe between the actions of a chunk does not change the recording."""
    env = Counting(4)
    with recording(env, _config(tmp_path), [_job(7)], 10.0) as recorder:
        assert recorder is not None
        client = recorder.listen(Chunks())
        recorder.get_obs()
        while not recorder.is_episode_end():
            for action in client.call(func_name="get_action")[: 4 - env._steps[0]]:
                recorder.take_action(action)
        recorder.keep([_line()])
    episode = trajectory.read(tmp_path / "episode_0000007.hdf5")
    assert [obs["state"][STATE[0]].tolist() for obs, _ in episode] == [[0.0], [1.0], [2.0], [3.0]]
    assert [action[STATE[0]].tolist() for _, action in episode] == [[0], [1], [2], [3]]
    assert [episode.facts(step)["asked"] for step in range(4)] == [True, False, False, True]
    assert "privileged" not in episode.observation(0)
    metadata = {"task": "lift", "seed": 107, "robot": "arx_x5", "policy": "P", "environment": "E", "success": True}
    assert metadata.items() <= episode.episode.items()
    assert episode.frequency == 10.0


@pytest.mark.parametrize("may_know", [True, False])
def test_privileged_observations_are_recorded_on_request_and_hidden_from_the_policy(
    tmp_path: Path, may_know: bool
) -> None:
    """The file is the same; a policy without `privileged` among its inputs sees what it always sees."""
    env = Counting(3)
    with recording(env, _config(tmp_path, privileged=may_know), [_job(0)], 10.0) as recorder:
        assert recorder is not None
        assert ("privileged" in recorder.get_obs()) == may_know
        assert ("privileged" in recorder.get_obs_batch([0])[0]) == may_know
        rollout.run_episode(recorder, recorder.listen(Chunks()))
        recorder.keep([_line()])
    episode = trajectory.read(tmp_path / "episode_0000000.hdf5")
    assert [obs["privileged"] for obs, _ in episode] == [{"truth": 1.0}] * 3
    assert episode.episode["privileged"] == {"recorded": ["truth"], "left_out": {}}


def test_a_batch_becomes_one_file_for_each_episode(tmp_path: Path) -> None:
    """They end one by one; environments without a job leave nothing."""
    env = Counting(2, 5, 3)
    with recording(env, _config(tmp_path), [_job(0), _job(1)], 25.0) as recorder:
        assert recorder is not None
        rollout.run_batch(recorder, recorder.listen(Chunks()), horizon=2)
        recorder.keep([_line(), _line()])
    episodes = trajectory.open_folder(tmp_path)
    assert [(one.key, len(one)) for one in episodes] == [("episode_0000000", 2), ("episode_0000001", 5)]
    assert episodes[1].observation(4)["state"][STATE[1]].tolist() == [4.0]


@pytest.mark.parametrize(
    ("keep", "line", "is_saved"),
    [
        (ALL, _line(success=False, failure="task"), True),
        (SUCCESS, _line(success=False, failure="task"), False),
        (SUCCESS, _line(), True),
        (ALL, _line(success=False, failure="policy"), False),
        (ALL, _line(success=False, failure="infrastructure"), False),
    ],
)
def test_only_episodes_that_are_wanted_leave_a_file(
    tmp_path: Path, keep: str, line: EpisodeOutcome, is_saved: bool
) -> None:
    """Those that succeeded, or that ran to their end; never one that broke off."""
    with recording(Counting(2), _config(tmp_path, keep), [_job(0)], 25.0) as recorder:
        assert recorder is not None
        rollout.run_episode(recorder, recorder.listen(Chunks()))
        recorder.keep([line])
    names = {path.name for path in tmp_path.iterdir()}
    assert names == ({"episode_0000000.hdf5", "index.jsonl"} if is_saved else set())


def test_what_cannot_be_kept_ends_the_run_and_is_no_fault_of_the_policy(tmp_path: Path) -> None:
    """The loop goes on undisturbed; the sentence comes when the episode has ended."""
    env = Counting(2)
    env.get_obs_batch = lambda *_: [{"state": {STATE[0]: np.zeros(1 + env._steps[0])}}]  # type: ignore[method-assign]
    with recording(env, _config(tmp_path), [_job(0)], 25.0) as recorder:
        assert recorder is not None
        rollout.run_episode(recorder, recorder.listen(Chunks()))
        with pytest.raises(UserError, match=r"cannot be recorded.*step 1: expected \(1,\)"):
            recorder.keep([_line()])
    assert not list(tmp_path.iterdir())
