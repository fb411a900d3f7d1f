"""Scripted observations in RoboDojo's form: no two environments, layouts, steps, arms or cameras look alike.

Source: RoboDojo-Benchmark/RoboDojo, env/observation_manager/obs_manager.py at 36bfcb7.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from xpl import _spec as spec
from xpl.embodiment import Embodiment

EXTRINSIC_MATRIX = spec.READ_ALIASES[spec.Camera.EXTRINSICS_MATRIX][
    0
]  # RoboDojo's spelling, and another direction than the standard's
_OPENING = 1.0  # every episode begins with open grippers (env/robot_manager/robot_manager.py:107)


class Scene:
    """The observations of one environment in one episode.

    Args:
        robot: of the benchmark.
        layout: number of the layout, which determines all positions.
        size: height and width of images; None for no images.
        matrices: whether cameras have their matrices.
    """

    def __init__(self, robot: Embodiment, layout: int, size: tuple[int, int] | None, *, matrices: bool) -> None:
        self._robot, self._layout, self._size, self._matrices = robot, layout, size, matrices
        self._step = 0
        self._state: dict[str, np.ndarray] = {}
        for side, arm in enumerate(robot.arms):
            home = np.zeros(arm.dof) if arm.home is None else np.asarray(arm.home, np.float64)
            self._state[arm.prefix + spec.State.ARM_JOINT_STATE] = home + 0.01 * (1 + side)
            self._state[arm.prefix + spec.State.EE_JOINT_STATE] = np.full(arm.ee_dim, _OPENING)
            self._state[arm.prefix + spec.State.EE_POSE] = _pose(side, layout)

    def move(self, controls: Mapping[str, np.ndarray]) -> None:
        """Take what is commanded as what is; no arm moves the other way of saying where it is."""
        self._state.update(controls)
        self._step += 1

    def observe(self, instruction: str, frequency: float) -> dict[str, Any]:
        """Return the observation; the caller may change it.

        Returns:
            vectors are float64 arrays but for grippers, which are lists of one number; `action` repeats what was
            commanded, as RoboDojo has it.
        """
        state = {
            key: value.tolist() if key.endswith(spec.State.EE_JOINT_STATE) else value.copy()
            for key, value in self._state.items()
        }
        commanded = {key: value for key, value in state.items() if not key.endswith(spec.State.EE_POSE)}
        return {
            spec.Obs.VISION: {name: self._camera(index) for index, name in enumerate(self._cameras())},
            spec.Obs.STATE: state,
            "action": {key: list(value) for key, value in commanded.items()},
            spec.Obs.DATA_FORMAT_VERSION: spec.DATA_FORMAT_VERSION,
            spec.Obs.ADDITIONAL_INFO: {spec.Obs.FREQUENCY: frequency},
            spec.Obs.INSTRUCTION: instruction,
        }

    def _cameras(self) -> tuple[str, ...]:
        return () if self._size is None else tuple(self._robot.cameras)

    def _camera(self, index: int) -> dict[str, Any]:
        """Return a camera: above all red to the right, green downwards, and blue for where and when."""
        assert self._size is not None  # noqa: S101 - for the type checker: there are cameras
        height, width = self._size
        color = np.empty((height, width, spec.COLOR_CHANNELS), np.uint8)
        color[..., 0] = np.linspace(40, 220, width)
        color[..., 1] = np.linspace(20, 140, height)[:, None]
        color[..., 2] = (30 * index + 7 * self._layout + 3 * self._step) % 200
        camera: dict[str, Any] = {spec.Camera.COLOR: color, spec.Camera.SHAPE: color.shape}
        if self._matrices:
            focal = 0.9 * width
            camera[spec.Camera.INTRINSIC_MATRIX] = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
            camera[EXTRINSIC_MATRIX] = np.eye(4)
            camera[EXTRINSIC_MATRIX][:3, 3] = [0.1 * index, -0.41, 1.308]
        return camera


def _pose(side: int, layout: int) -> np.ndarray:
    """Return a pose of a flange, [x, y, z, qw, qx, qy, qz]."""
    angle = 0.4 + 0.3 * side + 0.01 * (layout % 50)
    turn = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * np.array([0.36, 0.48, 0.8]))])
    return np.concatenate([[-0.3 + 0.6 * side, -0.1 + 0.001 * (layout % 50), 0.95], turn])
