"""One task of gym-aloha in its own simulator; its numbers are converted to the standard's here and nowhere else."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import mul
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.environment import Episode, Setup
from xpl.episode import Simulated
from xpl.kinematics import Chain
from xpl.poses import pose
from xpl.rendering import choose_opengl

from .cameras import CameraRenderer
from .contacts import ContactTable
from .expert import Expert

if TYPE_CHECKING:
    from numpy.typing import NDArray

_PLACE = spec.POSITION_DIM
_JOINTS, _ARM = 6, 7  # joints of one arm, and with its gripper: gym-aloha's numbers are left arm, then right arm
_ROBOT = 16  # numbers of qpos before those of objects: a gripper has two
_SUCCESS = 4  # of gym-aloha's reward
_NO_PICTURE = np.zeros((1, 1, 3), dtype=np.uint8)  # gym-aloha's step would draw three, whoever looks


@dataclass(frozen=True)
class _Hand:
    """Where MuJoCo writes the flange of one arm: views of its memory, which each step and reset fill anew."""

    arm: str
    numbers: slice
    place: NDArray[np.float64]
    turn: NDArray[np.float64]
    matrix: NDArray[np.float64]


class AlohaEpisode(Episode):
    """An episode of a task.

    An action of gym-aloha is where joints go, rad, and how far grippers open, 0 to 1: the standard's own. Its fingers
    reach from 0.06 to 0.97 of that, so that no gripper ever says 0 or 1.
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        choose_opengl()
        from gym_aloha.env import AlohaEnv

        self._env = AlohaEnv(task=setup.task, obs_type="pixels_agent_pos")
        self._task, self._physics = self._env._env.task, self._env._env.physics  # noqa: SLF001 - it offers neither
        self._task.get_observation = self._without_rendering
        self._task.get_reward = _with_contact_table(self._task.get_reward, ContactTable(self._physics))
        self._renderer = CameraRenderer(self._physics, setup, setup.setting.split("_"))
        chain = Chain.from_embodiment(setup.embodiment.data)
        ahead = chain.tcp_from_flange(pose(np.zeros(_PLACE), rotation.identity()))
        self._ahead = ahead[:_PLACE].tolist()  # and turned alike
        self._arms = tuple(prefix.rstrip("_") for prefix in setup.embodiment.prefixes)
        self._hands = [self._hand(index, arm) for index, arm in enumerate(self._arms)]
        names, rows = setup.facts["objects"], self._physics.data.qpos[_ROBOT:].reshape(-1, spec.POSE_DIM)
        self._rows = dict(zip(names, rows, strict=True))
        self._expert = Expert(
            chain, {arm: self._body(self._named_values(f"vx300s_{arm}")) for arm in self._arms}, setup.task
        )

    def reset(self, seed: int) -> None:
        """Begin an episode; the seed draws where the objects lie."""
        obs, _ = self._env.reset(seed=seed)
        self._reward, self._highest = 0, 0
        self._last_command: np.ndarray | None = None
        self._look(obs)
        self._expert.begin(self._state, self._objects())

    def state(self) -> dict[str, NDArray[np.float64]]:
        """Return joints (rad), openings, the poses of the flanges and of the points between the fingers."""
        return self._state

    def step(self, action: Mapping[str, Any]) -> None:
        """Execute one action step: gym-aloha takes it as it is."""
        keys = (spec.State.ARM_JOINT_STATE, spec.State.EE_JOINT_STATE)
        parts = [action[f"{arm}_{key}"] for arm in self._arms for key in keys]
        # float32, as its action space says: it computes the fingers' positions in the type of the action.
        command = np.concatenate(parts).astype(np.float32)
        self._last_command = command.astype(np.float64)
        obs, self._reward, _, _, _ = self._env.step(command)
        self._highest = max(self._highest, self._reward)
        self._look(obs)
        self._expert.advance()

    def score(self) -> float:
        """Return the highest reward so far, as a share of that of success."""
        return float(self._highest) / _SUCCESS

    def vision(self) -> dict[str, dict[str, Any]]:
        """Return the pictures of the setting's cameras."""
        return self._renderer.seen()

    def truth(self) -> dict[str, Any]:
        """Return gym-aloha's reward and the poses of its objects, quaternions [w, x, y, z].

        A privileged policy also gets the action of an expert that plans by them.
        """
        values = {"reward": self._reward, **self._objects()}
        return {**values, "expert": self._expert.action()} if self.setup.privileged else values

    def simulated(self) -> Simulated:
        """Return gym-aloha's own observation, with its picture where pictures are wanted, and its last action (14,)."""
        env = self._env
        size = (env.observation_height, env.observation_width)
        top = self._renderer.drawn("top", *size) if self.setup.cameras else _NO_PICTURE
        return Simulated({"agent_pos": self._obs["agent_pos"], "pixels": {"top": top}}, self._last_command)

    def close(self) -> None:
        """Release the simulator and what draws."""
        self._env.close()
        self._physics.free()

    def _without_rendering(self, physics: Any) -> OrderedDict[str, Any]:
        """Return what gym-aloha's task observes, without its three pictures of 480 x 640."""
        return OrderedDict(qpos=self._task.get_qpos(physics), images={"top": _NO_PICTURE})

    def _objects(self) -> dict[str, NDArray[np.float64]]:
        """Return the pose (7,) of each object of the task by name."""
        return {name: row.copy() for name, row in self._rows.items()}

    def _look(self, obs: Mapping[str, Any]) -> None:
        self._obs = obs
        self._state = {}
        for hand in self._hands:  # few numbers: one by one they cost a fraction of what numpy takes for them
            numbers = obs["agent_pos"][hand.numbers]
            position, turn, matrix = hand.place.tolist(), hand.turn.tolist(), hand.matrix.tolist()
            between = [at + sum(map(mul, row, self._ahead)) for at, row in zip(position, matrix, strict=True)]
            self._state[f"{hand.arm}_{spec.State.ARM_JOINT_STATE}"] = numbers[:_JOINTS]
            self._state[f"{hand.arm}_{spec.State.EE_JOINT_STATE}"] = np.array([min(max(float(numbers[-1]), 0.0), 1.0)])
            self._state[f"{hand.arm}_{spec.State.EE_POSE}"] = np.array([*position, *turn])
            self._state[f"{hand.arm}_{spec.State.TCP_POSE}"] = np.array([*between, *turn])

    def _hand(self, number: int, arm: str) -> _Hand:
        body, data = self._named_values(f"vx300s_{arm}/gripper_link"), self._physics.data
        numbers = slice(_ARM * number, _ARM * (number + 1))
        return _Hand(arm, numbers, data.xpos[body], data.xquat[body], data.xmat[body].reshape(3, 3))

    def _named_values(self, body: str) -> int:
        number: int = self._physics.model.name2id(body, "body")
        return number

    def _body(self, body: int) -> NDArray[np.float64]:
        """Return the pose (7,) of a body of the model in the world."""
        data = self._physics.data
        return pose(data.xpos[body], data.xquat[body])


def _with_contact_table(own: Callable[[Any], int], touching: ContactTable) -> Callable[[Any], int]:
    """Return gym-aloha's own reward with faster access to contacts."""

    def reward(_physics: Any) -> int:
        touching.look()
        return own(touching)

    return reward
