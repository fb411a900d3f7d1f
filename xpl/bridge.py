"""Bridge: compare the commands of an adapter with those of the authors' own client, at the same simulator.

    bridge = Bridge(make(config), their_client)
    bridge.reset([0])
    run_episode(bridge, xpl.Client(url), horizon=8)
    print(bridge.verdict(tolerance=1e-3))

An adapter and an environment package may have the same error: both mirror an image, both invert a gripper, and every
check of the two agrees. The authors' client of a model needs neither: it maps the simulator's own observation to the
simulator's own command. At every control step the bridge passes it the simulator's observation, and compares its
command with the one that the simulator received, in the simulator's own units.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Callable

import numpy as np

from xpl import _spec as spec
from xpl.episode import CORRECTIONS, Simulated

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from xpl.contract import Action, ObservationDict

__all__ = ["Bridge", "BridgeError", "BridgeVerdict", "CommandPair", "Simulated"]


class BridgeError(RuntimeError):
    """The commands cannot be compared; the text says why."""


@dataclass(frozen=True)
class CommandPair:
    """The commands of one control step.

    Attributes:
        step: number of the step in its episode, from 0.
        ours: (N,) float64, the command that the simulator received from adapter and environment package.
        theirs: (N,) float64, the command of the authors' client.
        corrected: whether the robot's limits changed the action, so that the two may differ.
    """

    step: int
    ours: NDArray[np.float64]
    theirs: NDArray[np.float64]
    corrected: bool


@dataclass(frozen=True)
class BridgeVerdict:
    """Result of a bridge.

    Attributes:
        agree: whether no component of any step differs by more than the tolerance.
        steps: number of control steps compared.
        corrected: number of steps not compared, because the robot's limits changed the action.
        largest: (N,) largest difference of each component, as a share of the range of the authors' commands.
        first: the first step that differs by more; None if they agree.
    """

    agree: bool
    steps: int
    corrected: int
    largest: NDArray[np.float64]
    first: CommandPair | None

    def __str__(self) -> str:
        """Return one sentence."""
        apart = f"{self.corrected} steps were corrected and are left out" if self.corrected else "no step was corrected"
        if self.first is None:
            off = f"off by {self.largest.max():.2g} of the span at most"
            return f"both command the same: {self.steps} steps, {off}; {apart}"
        number = int(np.argmax(np.abs(self.first.ours - self.first.theirs)))
        return (
            f"the commands differ, first at step {self.first.step}: number {number} of the command is "
            f"{self.first.ours[number]:.6g} through adapter and environment, and {self.first.theirs[number]:.6g} by "
            f"the authors' client; {apart}"
        )


class Bridge:
    """An environment that compares every command with that of the authors' client.

    Use it like the environment, for example with `xpl.rollout.run_episode`. The client is called at every control step
    with the simulator's observation, and must use the same execution horizon as the loop.

    Args:
        task_env: the only environment of its process; it has `simulated()`, which returns `Simulated`
            (`xpl.Episode.simulated` for environments of the SDK).
        client: the authors' client: (simulator's observation, instruction) -> command (N,). Its
            `reset`, if it has one, is called when an episode begins.
    """

    def __init__(self, task_env: Any, client: Callable[[Any, str], Any]) -> None:
        self._env, self._client = task_env, client
        self._instruction = ""
        self._steps = 0
        self.pairs: list[CommandPair] = []

    def __getattr__(self, name: str) -> Any:
        """Return another attribute of the environment."""
        return getattr(self._env, name)

    def reset(self, seed: Sequence[int] | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Begin an episode in the simulator and in the authors' client."""
        self._env.reset(seed, options)
        reset = getattr(self._client, spec.Method.RESET, None)
        if reset is not None:
            reset()
        self._steps = 0

    def get_obs(self) -> ObservationDict:
        """Return the observation of the standard."""
        obs: ObservationDict = self._env.get_obs()
        self._instruction = str(obs.get(spec.Obs.INSTRUCTION, ""))
        return obs

    def take_action(self, action: Action) -> Any:
        """Call the authors' client, execute the adapter's action, and record both commands.

        Raises:
            BridgeError: the environment has no `simulated()`, or the client returns a command of another size.
        """
        theirs = _command(self._client(self._simulated().observation, self._instruction), "the authors' client")
        report = self._env.take_action(action)
        ours = _command(self._simulated().command, "the simulator")
        if ours.shape != theirs.shape:
            raise BridgeError(
                f"the simulator received {ours.size} numbers, the authors' client commands {theirs.size}: both must be "
                "the simulator's own command"
            )
        corrected = bool(isinstance(report, Mapping) and report.get(CORRECTIONS))
        self.pairs.append(CommandPair(self._steps, ours, theirs, corrected))
        self._steps += 1
        return report

    def verdict(self, tolerance: float = 1e-3) -> BridgeVerdict:
        """Compare the commands of the steps so far.

        Args:
            tolerance: largest difference of a component, as a share of the range of the authors' commands.

        Returns:
            The verdict.

        Raises:
            BridgeError: no step can be compared.
        """
        compared = [one for one in self.pairs if not one.corrected]
        if not compared:
            raise BridgeError(f"no step can be compared: {len(self.pairs)} were executed, all corrected")
        theirs = np.stack([one.theirs for one in compared])
        span = np.ptp(theirs, axis=0)
        span[span == 0] = np.maximum(np.abs(theirs[0]), 1.0)[span == 0]
        shares = np.abs(np.stack([one.ours for one in compared]) - theirs) / span
        off = ~(shares <= tolerance).all(axis=1)  # NaN differs
        first = compared[int(np.argmax(off))] if off.any() else None
        return BridgeVerdict(first is None, len(compared), len(self.pairs) - len(compared), shares.max(axis=0), first)

    def _simulated(self) -> Simulated:
        method = getattr(self._env, "simulated", None)
        simulated = method() if callable(method) else None
        if not isinstance(simulated, Simulated):
            raise BridgeError(
                f"{type(self._env).__name__} has no observation and command of its simulator: its episode needs "
                "`simulated()`, which returns xpl.bridge.Simulated"
            )
        return simulated


def _command(values: object, whose: str) -> NDArray[np.float64]:
    try:
        return np.asarray(values, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise BridgeError(f"{whose} must return a command of numbers, got {type(values).__name__}") from None
