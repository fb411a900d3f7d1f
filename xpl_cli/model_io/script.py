"""Scripted episodes in which every mistake of a conversion shows; reference.py and the adapter both answer them.

An observation has a recipe, two numbers: the environment, and an index (`100 * episode + control step`). Images have
fine detail and no symmetry; joints, some near their limits, and poses agree by the robot's kinematics where the
standard knows them; quaternions come with both signs, some near a half-turn; every gripper has an opening of its own;
instructions have capitals, outer spaces, a line break, an underscore and full stops, as policies strip or replace them.

Calls observe and act as environments do: one environment, several in changing batches, an observation without a request
for actions, a history that builds up, resets.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as sdk
from xpl import poses, rotation
from xpl.conventions.frame import mount
from xpl.conventions.point import tool
from xpl.convert import ConversionError
from xpl.kinematics import Chain, KinematicsError
from xpl.manifest import CameraNeeds
from xpl_cli.model_io import test_images

if TYPE_CHECKING:
    from xpl.contract import ObservationDict
    from xpl.embodiment import Arm, Embodiment
    from xpl.manifest import Manifest

VERSION = 2
"""Of what a recipe stands for. Pairs of another version cannot be compared."""

EPISODE = 100
"""Places of one episode."""
_SIZE = (480, 640)
"""Height and width of images where the manifest asks for no larger ones: those of most robots' cameras."""
_FREQUENCY = 25.0
_INSTRUCTIONS = (
    "  Put the RED block into the left tray.\n",
    "open the drawer, then take the Green cup ",
    "push the blue_box away.",
    " Stack both Bowls on the plate! ",
)
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_ROTATION = slice(sdk.POSITION_DIM, sdk.POSE_DIM)
_CANDIDATES = 48
"""Postures among which one is chosen."""
_HALF_TURN = (0.03, 0.2)
"""Where the scalar part of a quaternion near a half-turn lies: its sign is certain on every machine."""
_NEAR_HALF_TURN, _NEAR_LIMITS = 2, 3
"""Which of four moments has a posture of that kind."""
_ENVS = (0, 2, 5)
_LONGEST = EPISODE - 8
"""Control steps after which a history is not waited for."""


@dataclass(frozen=True)
class Call:
    """One thing that happens; exactly one of the three.

    Attributes:
        reset: all environments begin their next episode.
        show: observations in one batch: environment and place of each.
        ask: environments in one batch.
    """

    reset: bool = False
    show: tuple[tuple[int, int], ...] = ()
    ask: tuple[int, ...] = ()


def cameras(manifest: Manifest, embodiment: Embodiment) -> dict[str, tuple[int, int]]:
    """Return height and width of the images of each camera that a manifest reads, or that the robot has.

    Raises:
        ConversionError: if the adapter needs what only a simulator can give.
    """
    if sdk.Obs.PRIVILEGED in manifest.required:
        raise ConversionError("the adapter needs privileged observations, which only a simulator can give")
    read = [name.partition(".")[2] for name in manifest.read if name.startswith(f"{sdk.Obs.VISION}.")]
    declared = manifest.cameras
    return {name: _size(declared.get(name, CameraNeeds())) for name in dict.fromkeys((*embodiment.cameras, *read))}


def _size(needs: CameraNeeds) -> tuple[int, int]:
    height, width = needs.height, needs.width
    if not height or not width:
        return _SIZE
    if needs.exact:
        return height, width
    factor = max(1, math.ceil(_SIZE[0] / height), math.ceil(_SIZE[1] / width))
    return height * factor, width * factor  # of the same aspect


def full_script(span: int) -> tuple[Call, ...]:
    """Return the calls for one robot and action type.

    Args:
        span: control steps that the policy's history reaches over, 1 without one.
    """
    stage, (one, two, three) = _CallScript(), _ENVS
    stage.reset()
    stage.show(one)
    stage.ask(one)
    stage.show(one)  # without a request for actions
    stage.show(one, two)
    stage.ask(two, one)
    stage.show(two, one, three)
    stage.ask(one, three)
    for _ in range(min(span, _LONGEST) - 3):
        stage.show(one, two)
    stage.show(two)
    stage.ask(two)
    stage.show(one, three)
    stage.ask(three, one)
    stage.show(one)
    stage.ask(one)
    stage.reset()
    stage.show(two, one)
    stage.ask(two, one)
    stage.show(one)
    stage.ask(one)
    stage.show(three, two, one)
    stage.ask(one, two, three)
    for _ in range(min(span, _LONGEST) - 2):
        stage.show(two)
    stage.show(two, one)
    stage.ask(one, two)
    stage.reset()
    stage.show(one)
    stage.ask(one)
    stage.show(one, two)
    stage.ask(one, two)
    return tuple(stage.calls)


def short_script() -> tuple[Call, ...]:
    """Return few calls: for further robots and action types, and for models with many takes."""
    stage, (one, two, _) = _CallScript(), _ENVS
    stage.reset()
    stage.show(one)
    stage.ask(one)
    stage.show(one)
    stage.show(one, two)
    stage.ask(two, one)
    stage.reset()
    stage.show(two)
    stage.ask(two)
    return tuple(stage.calls)


class _CallScript:
    """Counts the places of each environment while calls are written down."""

    def __init__(self) -> None:
        self.calls: list[Call] = []
        self._episode = -1
        self._steps: dict[int, int] = {}

    def reset(self) -> None:
        self.calls.append(Call(reset=True))
        self._episode += 1
        self._steps = {}

    def show(self, *envs: int) -> None:
        self.calls.append(Call(show=tuple((env, self._place(env)) for env in envs)))

    def ask(self, *envs: int) -> None:
        self.calls.append(Call(ask=envs))

    def _place(self, env: int) -> int:
        next_step = self._steps[env] = self._steps.get(env, -1) + 1
        return EPISODE * self._episode + next_step


@dataclass(frozen=True)
class ScriptedScene:
    """A robot and its cameras, from which observations are made.

    Attributes:
        embodiment: the robot.
        cameras: height and width of each camera's images.
    """

    embodiment: Embodiment
    cameras: Mapping[str, tuple[int, int]]

    def observation(self, env: int, index: int) -> ObservationDict:
        """Return the standard observation of a recipe."""
        moment = 1009 * env + index
        vision = {
            name: self._camera(number, moment, *size)
            for number, (name, size) in enumerate(sorted(self.cameras.items()))
        }
        return {
            sdk.Obs.DATA_FORMAT_VERSION: sdk.DATA_FORMAT_VERSION,
            sdk.Obs.INSTRUCTION: _INSTRUCTIONS[(env + index // EPISODE) % len(_INSTRUCTIONS)],
            sdk.Obs.ENV_IDX: env,
            sdk.Obs.ADDITIONAL_INFO: {sdk.Obs.FREQUENCY: _FREQUENCY},
            sdk.Obs.VISION: vision,
            sdk.Obs.STATE: self.state(env, index),
        }

    def state(self, env: int, index: int) -> dict[str, np.ndarray]:
        """Return the state in the observation of a recipe; it takes no pictures to make it."""
        moment = 1009 * env + index
        state: dict[str, np.ndarray] = {}
        for side, arm in enumerate(self.embodiment.arms):
            state.update(self._arm(arm, side, moment))
        return state

    def observations(self, recipes: Sequence[tuple[int, int]]) -> list[ObservationDict]:
        """Return the observations of a batch."""
        return [self.observation(env, index) for env, index in recipes]

    @cached_property
    def _chain(self) -> Chain | None:
        try:
            return Chain.from_embodiment(self.embodiment.data)
        except KinematicsError:
            return None

    @cached_property
    def _mounts(self) -> list[np.ndarray]:
        """Pose (7,) of each arm's base in the world."""
        still = poses.pose(np.zeros(sdk.POSITION_DIM), rotation.identity())
        try:
            return [mount(self.embodiment, name) for name in self.embodiment.data["arms"]]
        except ConversionError:
            return [still for _ in self.embodiment.arms]

    @cached_property
    def _tool(self) -> np.ndarray:
        """Pose (7,) of the point between the fingertips in the flange."""
        try:
            return tool(self.embodiment)
        except ConversionError:
            return poses.pose([0.0, 0.0, 0.1], rotation.identity())

    def _arm(self, arm: Arm, side: int, moment: int) -> dict[str, np.ndarray]:
        joints, flange = self._posture(arm, side, moment)
        sign = 1.0 if _spread(1, 11 * moment + side)[0] < 0.5 else -1.0
        flange[_ROTATION] *= math.copysign(1.0, flange[_ROTATION][0]) * sign
        return {
            arm.prefix + name: np.asarray(value, np.float32)
            for name, value in {
                sdk.State.ARM_JOINT_STATE: joints,
                sdk.State.EE_JOINT_STATE: self._effector(arm, side, moment),
                sdk.State.EE_POSE: flange,
                sdk.State.TCP_POSE: poses.compose(flange, self._tool),
                sdk.State.DELTA_EE_POSE: np.concatenate(
                    [0.002 * _spread(sdk.POSITION_DIM, moment + side), _oblique(0.02 + 0.01 * side)]
                ),
            }.items()
        }

    def _posture(self, arm: Arm, side: int, moment: int) -> tuple[np.ndarray, np.ndarray]:
        """Return joints (dof,) and the flange's pose (7,) in the world that goes with them.

        Of four moments one has joints near their limits, and one a rotation near a half-turn, if there is any. None has
        a rotation whose sign rounding decides.
        """
        best: tuple[float, np.ndarray, np.ndarray] | None = None
        for number in range(_CANDIDATES):
            seed = _CANDIDATES * (2 * moment + side) + number
            if moment % 4 == _NEAR_LIMITS:
                near = 0.02 + 0.03 * _spread(arm.dof, seed)
                fractions = np.where((np.arange(arm.dof) + moment // 4 + side) % 2 == 1, near, 1.0 - near)
            else:
                fractions = 0.12 + 0.76 * _spread(arm.dof, seed)
            joints, flange = self._placed(arm, side, moment, fractions)
            scalar = abs(float(flange[_ROTATION][0]))
            if scalar < _HALF_TURN[0]:
                continue
            if best is None or scalar < best[0]:
                best = scalar, joints, flange
            if moment % 4 != _NEAR_HALF_TURN or scalar < _HALF_TURN[1]:
                return joints, flange
        return (joints, flange) if best is None else best[1:]

    def _placed(self, arm: Arm, side: int, moment: int, fractions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        lower = np.full(arm.dof, -1.0) if arm.lower is None else arm.lower
        upper = np.full(arm.dof, 1.0) if arm.upper is None else arm.upper
        joints = (lower + fractions * (upper - lower)).astype(np.float32)
        if self._chain is not None:
            return joints, poses.compose(self._mounts[side], self._chain.flange(joints.astype(np.float64)))
        position = np.array([0.4, 0.2 * (1 - 2 * side), 0.3]) + 0.2 * (_spread(sdk.POSITION_DIM, moment + side) - 0.5)
        angle = 3.02 if moment % 4 == _NEAR_HALF_TURN else 0.3 + 2.4 * _spread(1, moment + 5 * side)[0]
        return joints, poses.pose(position, _oblique(angle))

    def _effector(self, arm: Arm, side: int, moment: int) -> np.ndarray:
        """Return openings 0..1, sometimes quite closed or quite open, or a hand's angles, rad."""
        values = 0.05 + 0.9 * _spread(arm.ee_dim, 3 * moment + 7 * side + 1)
        if arm.gripper == "parallel_gripper" and moment % 5 == 4 - 2 * side:
            return np.full(arm.ee_dim, float((moment + side) % 2))
        return values

    @staticmethod
    def _camera(number: int, moment: int, height: int, width: int) -> dict[str, Any]:
        focal = 0.9 * width
        extrinsics = np.eye(4, dtype=np.float32)
        extrinsics[:3, 3] = [0.1 * (number + 1), -0.2, 0.8]
        return {
            sdk.Camera.COLOR: test_images.test_image(number, moment, height, width),
            sdk.Camera.INTRINSIC_MATRIX: np.array(
                [[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]], np.float32
            ),
            sdk.Camera.EXTRINSICS_MATRIX: extrinsics,
            sdk.Camera.SHAPE: np.array([height, width]),
        }


def with_episode_numbers(calls: Sequence[Call]) -> Iterator[tuple[Call, int]]:
    """Yield each call with the number of the episode that it belongs to: a reset begins the next one."""
    episode, has_observed = 0, False
    for call in calls:
        if call.reset and has_observed:
            episode, has_observed = episode + 1, False
        has_observed = has_observed or bool(call.show)
        yield call, episode


def _spread(count: int, number: int) -> np.ndarray:
    """Return `count` numbers in 0..1, which no other number has: a low-discrepancy sequence in each place."""
    step = np.power(_GOLDEN, np.arange(1, count + 1))
    return np.asarray((0.5 + (number + 1) * step + 0.37 * np.arange(count)) % 1.0)


def _oblique(angle: float) -> np.ndarray:
    """Return a rotation about a fixed, oblique axis as [qw, qx, qy, qz]."""
    axis = np.array([0.36, 0.48, 0.8])
    return np.concatenate([[math.cos(angle / 2)], math.sin(angle / 2) * axis])
