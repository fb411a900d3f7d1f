"""A bridge: the authors' client and our route command the same motion, or the first step that differs is told."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from xpl import Policy
from xpl.bridge import Bridge, BridgeError, BridgeVerdict, Simulated
from xpl.environment import Environment, Episode
from xpl.manifest import EnvManifest
from xpl.rollout import run_episode

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

HEIGHT = 512
"""Of the table of the simulator, whose numbers are pixels, counted downwards."""
MANIFEST = {
    "spec": "v1",
    "name": "table",
    "embodiments": ["franka_single"],
    "action_types": ["ee"],
    "control_frequency": 10,
    "privileged": False,
    "settings": ["clean"],
    "cameras": {},
    "tasks": {"push": {"instruction": "push right", "max_steps": 9}},
}
CONFIG = {"task": "push", "embodiment": "franka_single", "cameras": False}


class Table(Episode):
    down, metre = -1.0, 1000.0

    def reset(self, seed: int) -> None:
        self.disc = np.random.default_rng(seed).uniform(100, 400, 2)
        self.told: NDArray[np.float64] | None = None

    def state(self) -> Mapping[str, Any]:
        x, y = self.disc[0] / self.metre, (self.down * self.disc[1] + HEIGHT * (self.down < 0)) / self.metre
        return {"ee_pose": np.array([x, y, 0.1, 1, 0, 0, 0]), "ee_joint_state": np.zeros(1)}

    def step(self, action: Mapping[str, Any]) -> None:
        x, y = action["ee_pose"][:2] * self.metre
        self.told = np.array([x, (y - HEIGHT * (self.down < 0)) * self.down])
        self.disc = self.told

    def score(self) -> float:
        return 0.0

    def simulated(self) -> Simulated:
        return Simulated(self.disc.copy(), self.told)


class Mirrored(Table):
    """Takes y for upwards in the simulator, both ways: its own checks all pass."""

    down = 1.0


class Silent(Table):
    def simulated(self) -> None:
        return


def network(disc: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where the model wants the disc next, (3, 2), in pixels: to the right, and a little down."""
    return np.asarray(disc) + np.array([[2.0, 1.0]]) * np.arange(1, 4)[:, None] + np.asarray(disc) / 200


class Client:
    """The authors': pixels in, pixels out; asks its network again when two actions of a chunk are executed."""

    def __init__(self) -> None:
        self.resets: list[int] = []
        self.instructions: set[str] = set()

    def reset(self) -> None:
        self.resets.append(0)
        self.left: list[Any] = []

    def __call__(self, observation: Any, instruction: str) -> Any:
        self.instructions.add(instruction)
        self.left = self.left or list(network(observation)[:2])
        return self.left.pop(0)


class Adapter(Policy):
    """The same network, asked in the standard's words; knows the table as its authors do."""

    def encode(self, obs: Any, env: int) -> Any:
        x, y = np.asarray(obs["state"]["ee_pose"], np.float64)[:2] * 1000
        return np.array([x, HEIGHT - y])

    def predict(self, inputs: Any, envs: Sequence[int]) -> Any:
        return np.stack([network(one) for one in inputs])

    def decode(self, output: Any, obs: Any, env: int) -> Any:
        return [self._pose(obs, *pixels) for pixels in output]

    def _pose(self, obs: Any, x: float, y: float) -> Any:
        pose = np.array(obs["state"]["ee_pose"], np.float32)
        pose[:2] = x / 1000, (HEIGHT - y) / 1000
        return {"ee_pose": pose, "ee_joint_state": np.zeros(1, np.float32)}


class Shifted(Adapter):
    def encode(self, obs: Any, env: int) -> Any:
        return super().encode(obs, env) + 1


class Asked:
    def __init__(self, policy: Policy) -> None:
        self.policy = policy

    def call(self, func_name: str, obs: Any = None) -> Any:
        operation = getattr(self.policy, func_name)
        return operation() if obs is None else operation(obs)


def crossed(
    episode: type[Episode], adapter: type[Policy] = Adapter, client: Callable[..., Any] | None = None
) -> Bridge:
    bridge = Bridge(Environment(episode, EnvManifest.parse(MANIFEST), CONFIG), client or Client())
    policy = adapter({"env_cfg_type": "franka_single", "action_type": "ee", "manifest": {"temporal": {"chunk": 3}}})
    for seed in (3, 4):
        bridge.reset([seed])
        run_episode(bridge, Asked(policy), horizon=2)
    return bridge


def test_two_routes_that_are_right_command_the_same() -> None:
    client = Client()
    found = crossed(Table, client=client).verdict()
    assert (found.agree, found.steps, found.corrected, found.first) == (True, 18, 0, None)
    assert found.largest.max() < 1e-5
    assert str(found).startswith("both command the same: 18 steps")
    assert (len(client.resets), client.instructions) == (2, {"push right"})


@pytest.mark.parametrize(
    ("episode", "adapter"), [(Mirrored, Adapter), (Table, Shifted)], ids=["environment", "adapter"]
)
def test_a_mistake_on_either_side_is_told_at_its_first_step(episode: type[Episode], adapter: type[Policy]) -> None:
    found = crossed(episode, adapter).verdict()
    assert not found.agree
    assert found.first is not None
    assert found.first.step == 0
    assert "the commands differ, first at step 0: number" in str(found)


def test_steps_that_the_robot_s_limits_changed_are_left_out() -> None:
    class Far(Adapter):
        def _pose(self, obs: Any, x: float, y: float) -> Any:
            return super()._pose(obs, x + 5000, y)

    bridge = crossed(Table, Far)
    assert all(one.corrected for one in bridge.pairs)
    with pytest.raises(BridgeError, match=r"no step can be compared: \d+ were executed, all corrected"):
        bridge.verdict()


def test_what_cannot_be_compared_is_said() -> None:
    with pytest.raises(BridgeError, match="needs `simulated\\(\\)`"):
        crossed(Silent)
    with pytest.raises(BridgeError, match="received 2 numbers, the authors' client commands 7"):
        crossed(Table, client=lambda _observation, _instruction: np.zeros(7))
    with pytest.raises(BridgeError, match="must return a command of numbers, got dict"):
        crossed(Table, client=lambda _observation, _instruction: {"x": 1})


def test_a_number_that_is_none_differs() -> None:
    bridge = crossed(Table)
    bridge.pairs[4].ours[1] = np.nan
    found: BridgeVerdict = bridge.verdict()
    assert not found.agree
    assert found.first is bridge.pairs[4]
