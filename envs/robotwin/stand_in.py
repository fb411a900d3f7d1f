"""A mock with the interface of RoboTwin's Base_Task, for rehearsals and tests of the loop.

Commands become the state. Of five seeds one is unstable and one is not solved by the expert. There is no success,
unless a test requests one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from xpl import _spec as sdk

SIZE = (240, 320)
_JOINTS, _POSE = 6, 7
_FLAT = {"qpos": 2 * (_JOINTS + 1), "ee": 2 * (_POSE + 1)}


class UnstableError(Exception):
    """Mock of RoboTwin's UnStableError."""


class MockSource:
    """The source of mock tasks.

    Args:
        step_lim: control steps of an episode.
        succeeds_at: control step with which an episode succeeds; None for never.
        size: height and width of images.
    """

    unstable = UnstableError
    has_expert = True

    def __init__(self, step_lim: int = 20, succeeds_at: int | None = None, size: tuple[int, int] = SIZE) -> None:
        self._made = step_lim, succeeds_at, size

    def make(self, task: str) -> MockTask:
        """Return a task."""
        return MockTask(task, *self._made)

    def arguments(self, task: str, setting: str) -> dict[str, Any]:
        """Return what RoboTwin's loop hands on."""
        return {sdk.Deploy.TASK_NAME: task, "task_config": setting, "render_freq": 0, "clear_cache_freq": 5}

    def describe(self, task: str, info: Mapping[str, Any], count: int, seed: int) -> Mapping[str, list[str]]:
        """Return one wording of each kind."""
        return {"seen": [f"do {task} with {info['{A}']}"], "unseen": [f"please do {task} with {info['{A}']}"]}


class MockTask:
    """One task, one episode after the other; names are RoboTwin's.

    Attributes:
        eval_success, take_action_cnt, step_lim: state of the episode.
        plan_success: whether the expert found its paths.
        joints, grippers, poses: commanded values, left arm first.
        robot: has these, and the poses of the tools.
        eval_video_path, render_freq: no videos, no window.
    """

    def __init__(self, name: str, step_lim: int, succeeds_at: int | None, size: tuple[int, int]) -> None:
        self.name, self._limit, self._succeeds_at, self._size = name, step_lim, succeeds_at, size
        self.eval_video_path = None
        self.render_freq = 0
        self.robot = _Robot(self)

    def setup_demo(self, now_ep_num: int = 0, seed: int = 0, is_test: bool = False, **kwargs: Any) -> None:  # noqa: FBT001, FBT002 - RoboTwin's own signature
        """Begin an episode.

        Raises:
            UnstableError: the seed is one of those.
        """
        if seed % 5 == 3:
            raise UnstableError(f"Objects is unstable in seed({seed})")
        self.seed, self.take_action_cnt, self.step_lim = seed, 0, self._limit
        self.eval_success, self.plan_success = False, True
        self.instruction: str | None = None
        self.joints = np.linspace(0.1, 0.6, 2 * _JOINTS) + 0.01 * (seed % 10)
        self.grippers = [1.0, 1.0]
        self.poses = [np.array([0.1 * side, 0.2, 0.9, 1.0, 0.0, 0.0, 0.0]) for side in (-1, 1)]

    def play_once(self) -> dict[str, Any]:
        """Let the expert run; return the names of objects."""
        return {"info": {"{A}": "the red block"}}

    def check_success(self) -> bool:
        """Return whether the expert has solved it."""
        return bool(self.seed % 5 != 4)

    def close_env(self, clear_cache: bool = False) -> None:  # noqa: FBT001, FBT002 - RoboTwin's own signature
        """Do nothing."""

    def set_instruction(self, instruction: str | None = None) -> None:
        """Take an instruction."""
        self.instruction = instruction

    def get_instruction(self, instruction: str | None = None) -> str | None:
        """Return it."""
        return self.instruction

    def get_obs(self) -> dict[str, Any]:
        """Return an observation in RoboTwin's form."""
        left, right = self.joints[:_JOINTS], self.joints[_JOINTS:]
        return {
            "observation": {
                name: self._camera(index) for index, name in enumerate(("head_camera", "left_camera", "right_camera"))
            },
            "pointcloud": [],
            "joint_action": {
                "left_arm": left.tolist(),
                "left_gripper": self.grippers[0],
                "right_arm": right.tolist(),
                "right_gripper": self.grippers[1],
                "vector": np.array([*left, self.grippers[0], *right, self.grippers[1]]),
            },
            "endpose": {
                "left_endpose": self.poses[0].tolist(),
                "left_gripper": self.grippers[0],
                "right_endpose": self.poses[1].tolist(),
                "right_gripper": self.grippers[1],
            },
        }

    def take_action(self, action: Any, action_type: str = "qpos") -> None:
        """Take a flat vector as what is: left arm, left gripper, right arm, right gripper."""
        if self.take_action_cnt == self.step_lim or self.eval_success:
            return
        flat = np.asarray(action, np.float64)
        if flat.shape != (_FLAT[action_type],):
            raise ValueError(f"{action_type} takes {_FLAT[action_type]} numbers, got shape {flat.shape}")
        self.take_action_cnt += 1
        arm = len(flat) // 2 - 1
        arms, self.grippers = [flat[:arm], flat[arm + 1 : -1]], [float(np.clip(flat[at], 0, 1)) for at in (arm, -1)]
        if action_type == "qpos":
            self.joints = np.concatenate(arms)
        else:
            self.poses = [part.copy() for part in arms]
        self.eval_success = self.take_action_cnt == self._succeeds_at

    def _camera(self, index: int) -> dict[str, Any]:
        height, width = self._size
        rgb = np.zeros((height, width, 3), np.uint8)
        rgb[..., 0] = np.linspace(40, 220, width)
        rgb[..., 1] = np.linspace(20, 140, height)[:, None]
        rgb[..., 2] = 40 * index + self.take_action_cnt % 50
        return {
            "rgb": rgb,
            "intrinsic_cv": np.array([[300.0, 0, width / 2], [0, 300.0, height / 2], [0, 0, 1]], np.float32),
            "extrinsic_cv": np.eye(4, dtype=np.float32)[:3] + 0.1 * index,
            "cam2world_gl": np.eye(4, dtype=np.float32),
        }


class _Robot:
    def __init__(self, task: MockTask) -> None:
        self._task = task

    def get_left_arm_jointState(self) -> list[float]:  # noqa: N802 - RoboTwin's own name
        return [*self._task.joints[:_JOINTS].tolist(), self._task.grippers[0]]

    def get_right_arm_jointState(self) -> list[float]:  # noqa: N802 - RoboTwin's own name
        return [*self._task.joints[_JOINTS:].tolist(), self._task.grippers[1]]

    def get_left_ee_pose(self) -> list[float]:
        return list(map(float, self._task.poses[0]))

    def get_right_ee_pose(self) -> list[float]:
        return list(map(float, self._task.poses[1]))

    def get_left_tcp_pose(self) -> list[float]:
        return [-0.1, 0.2, 0.8, 1.0, 0.0, 0.0, 0.0]

    def get_right_tcp_pose(self) -> list[float]:
        return [0.1, 0.2, 0.8, 1.0, 0.0, 0.0, 0.0]
