"""The base of environments: what a caller gets, and what is refused; the audit's rules prove the rest."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from xpl import _spec as spec
from xpl.action import ActionError
from xpl.environment import Environment, Episode, read_manifest
from xpl.manifest import EnvManifest

HOME = np.zeros(7)
MANIFEST: dict[str, Any] = {
    "embodiments": ["franka_single", "arx_x5"],
    "action_types": ["joint"],
    "cameras": {"cam_head": {}},
    "control_frequency": 10,
    "settings": ["clean", "dark"],
    "tasks": {
        "count": {"instruction": "count", "max_steps": 4, "arms": [1]},
        "wait": {"instruction": "wait", "max_steps": 9, "control_frequency": 5, "unsupported": {"arx_x5": "too small"}},
    },
}
CONFIG = {"task": "count", "embodiment": "franka_single"}
HOLD = {"arm_joint_state": HOME.astype(np.float32), "ee_joint_state": np.ones(1, np.float32)}


class _Counter(Episode):
    made = 0

    def __init__(self, setup: Any) -> None:
        super().__init__(setup)
        _Counter.made += 1
        self.closed = False

    def reset(self, seed: int) -> None:
        self.seed, self.count, self.at = seed, 0, HOME

    def state(self) -> dict[str, Any]:
        return {"arm_joint_state": self.at, "ee_joint_state": [1.0]}

    def step(self, action: Any) -> dict[str, dict[str, float]] | None:
        self.count += 1
        self.at = np.asarray(action["arm_joint_state"], np.float64)
        return {"": {"slipped": 0.5}} if self.count == 2 else None

    def score(self) -> float:
        return self.count / max(self.seed, 1)

    def vision(self) -> dict[str, dict[str, Any]]:
        return {"cam_head": {spec.Camera.COLOR: np.full((2, 2, 3), self.count, np.uint8)}}

    def truth(self) -> dict[str, Any]:
        return {"count": self.count}

    def close(self) -> None:
        self.closed = True


def _env(**config: Any) -> Environment:
    return Environment(_Counter, EnvManifest.parse(MANIFEST), {**CONFIG, **config})


def test_an_episode_ends_with_success_or_with_its_step_limit() -> None:
    env = _env(num_envs=2)
    env.reset([2, 50])
    assert env.get_running_env_idx_list() == [0, 1]
    for _ in range(4):
        running = env.get_running_env_idx_list()
        env.take_action_batch([HOLD for _ in running], running)
    assert env.is_episode_end()
    first, second = env.results()
    assert (first["success"], first["score"], first["steps"], first["end_reason"]) == (True, 1.0, 2, "success")
    assert (second["success"], second["steps"], second["end_reason"]) == (False, 4, "max_steps")
    assert second["score"] == pytest.approx(4 / 50)


@pytest.mark.parametrize(("real_time", "bent"), [(False, set()), (True, {"joint_speed"}), (None, {"joint_speed"})])
def test_speeds_are_limited_unless_a_simulation_says_otherwise(*, real_time: bool | None, bent: set[str]) -> None:
    """What may be a robot is limited, whatever its manifest says."""
    manifest = {**MANIFEST, "speed_limits": False, "real_time": real_time}
    env = Environment(_Counter, EnvManifest.parse(manifest), {**CONFIG, "seed": 5})
    env.reset()
    fast = {**HOLD, "arm_joint_state": np.full(7, 0.5, np.float32) * [1, 1, 1, -1, 1, 1, 1]}
    assert set(env.take_action(fast)["corrections"].get("", ())) == bent


def test_limits_are_kept_and_corrections_reported_and_counted() -> None:
    """A command beyond a joint's limit moves as far as its speed lets it; what the author reports is added."""
    env = _env()
    env.reset([50])
    far = {**HOLD, "arm_joint_state": np.full(7, 9.0, np.float32)}
    report = env.take_action(far)
    assert set(report["corrections"][""]) == {"joint_limit", "joint_speed"}
    state = env.get_obs()[spec.Obs.STATE]["arm_joint_state"]
    assert 0 < state.max() < 0.3
    assert set(env.take_action(HOLD)["corrections"][""]) >= {"slipped"}
    assert env.results()[0]["corrections"]["slipped"] == 1


def test_a_value_that_is_not_finite_ends_the_episode_and_reaches_no_simulator() -> None:
    env = _env(privileged=True)
    env.reset([50])
    report = env.take_action({**HOLD, "ee_joint_state": np.array([np.nan], np.float32)})
    assert report["end_reason"] == "non_finite_action"
    assert env.get_obs()[spec.Obs.PRIVILEGED] == {"count": 0}
    assert env.get_running_env_idx_list() == []


@pytest.mark.parametrize(
    ("action", "said"),
    [
        ({"arm_joint_state": HOLD["arm_joint_state"]}, "ee_joint_state"),
        ({**HOLD, "left_ee_pose": HOME}, "left_ee_pose"),
        ({**HOLD, "arm_joint_state": np.zeros(6, np.float32)}, "(7,)"),
        ([0.0] * 8, "map"),
    ],
)
def test_a_wrong_action_is_refused_by_name_and_nothing_moves(action: Any, said: str) -> None:
    env = _env(privileged=True)
    env.reset([50])
    with pytest.raises(ActionError, match=said.replace("(", r"\(").replace(")", r"\)")):
        env.take_action(action)
    assert env.get_obs()[spec.Obs.PRIVILEGED] == {"count": 0}


@pytest.mark.parametrize(
    ("config", "said"),
    [
        ({"task": "cont"}, "did you mean 'count'"),
        ({"embodiment": "franca_single"}, "did you mean franka"),
        ({"embodiment": "piper"}, "offers franka_single, arx_x5"),
        ({"embodiment": "arx_x5"}, "for 1 arms; arx_x5 has 2"),
        ({"task": "wait", "embodiment": "arx_x5"}, "too small"),
        ({"action_type": "ee"}, "offers joint"),
        ({"setting": "light"}, "offers clean, dark"),
        ({"num_envs": 0}, "num_envs must be at least 1"),
        ({"max_steps": 0}, "max_steps must be at least 1"),
        ({"cameras": [0, 3]}, "pixels"),
        ({"max_step": 3}, "did you mean 'max_steps'"),
        ({"task": None}, "lacks task; tasks are count, wait"),
    ],
)
def test_what_is_not_offered_is_refused_with_what_is(config: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        _env(**config)


def test_seeds_count_on_and_their_number_is_checked() -> None:
    env = _env(num_envs=2, seed=5)
    for expected in ([5, 6], [7, 8]):
        env.reset()
        assert [result["seed"] for result in env.results()] == expected
    with pytest.raises(ValueError, match="2 seeds"):
        env.reset([1])


def test_a_simulator_is_made_once_for_each_environment_until_the_options_change() -> None:
    """Building one is what takes long; the old one is closed."""
    env = _env()
    before = _Counter.made
    env.reset([1])
    env.reset([2])
    assert _Counter.made == before + 1
    episode = env._envs[0]._episode
    env.reset([2], {"task": "wait", "privileged": True})
    assert _Counter.made == before + 2
    assert isinstance(episode, _Counter)
    assert episode.closed
    assert env.get_obs()[spec.Obs.ADDITIONAL_INFO] == {spec.Obs.FREQUENCY: 5.0}


def test_last_frame_draws_nothing_and_an_observation_is_the_callers() -> None:
    env = _env()
    env.reset([50])
    (first,) = env.get_obs_batch()
    first[spec.Obs.STATE]["arm_joint_state"][:] = 7
    env.take_action(HOLD)
    assert env.get_obs_batch(last_frame=True)[0] is first
    (second,) = env.get_obs_batch()
    assert second[spec.Obs.VISION]["cam_head"][spec.Camera.COLOR].max() == 1
    assert second[spec.Obs.STATE]["arm_joint_state"].max() == 0
    assert _env(cameras=False)._setup.cameras is False


def test_people_see_through_any_camera(tmp_path: Path) -> None:
    env = _env(cameras=False)
    env.reset([50])
    assert env.render().shape == (2, 2, 3)
    with pytest.raises(ValueError, match="offers cam_head"):
        env.render(camera="cam_wrist")


def test_nothing_works_before_reset_and_indices_are_checked() -> None:
    env = _env(num_envs=2)
    with pytest.raises(RuntimeError, match="call reset first"):
        env.results()
    env.reset([1, 2])
    with pytest.raises(ValueError, match="indices go from 0 to 1"):
        env.get_obs_batch([2])
    with pytest.raises(ValueError, match="use get_obs_batch"):
        env.get_obs()
    with pytest.raises(ValueError, match="one action for each environment once"):
        env.take_action_batch([HOLD, HOLD], [0, 0])


def test_a_manifest_without_a_reader_of_yaml_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Simulators' own Pythons may lack PyYAML."""
    (tmp_path / "env.yml").write_text("name: Foo", encoding="utf-8")
    assert read_manifest(tmp_path / "client.py").name == "Foo"
    original = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "yaml":
            raise ImportError(name)
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(RuntimeError, match="pip install PyYAML"):
        read_manifest(tmp_path)
