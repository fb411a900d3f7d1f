"""A bridge: the authors' own client of a benchmark beside an environment package, at the same simulator.

    bridge = Bridge(make(config), their_client)
    bridge.reset([0])
    run_episode(bridge, xpl.Client(url), horizon=8)
    print(bridge.verdict(tolerance=1e-3))

An adapter and an environment package may be wrong alike: both mirror a picture, both turn a gripper round, and each
check of the two agrees. Whoever trained the model has a client that needs neither: from the simulator's own observation
to its own command. At every control step that client is told what the simulator observed, and what it commands is
compared with what the simulator was told, in the simulator's own units.
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

__all__ = ["Bridge", "BridgeError", "Crossing", "Simulated", "Verdict"]


class BridgeError(RuntimeError):
    """Two routes cannot be compared; the text says why."""


@dataclass(frozen=True)
class Crossing:
    """One control step.

    Attributes:
        step: number of the step in its episode, from 0.
        ours: (N,) float64, what the simulator was told through adapter and environment package.
        theirs: (N,) float64, what the authors' client commands.
        corrected: whether the robot's limits changed the action, so that the two may differ.
    """

    step: int
    ours: NDArray[np.float64]
    theirs: NDArray[np.float64]
    corrected: bool


@dataclass(frozen=True)
class Verdict:
    """What the steps of a bridge come to.

    Attributes:
        agree: whether no number of any step differs by more than the tolerance.
        steps: control steps that were compared.
        corrected: steps that were not: the limits of the robot changed the action.
        largest: (N,) the largest difference of each number, as a share of the span of the authors' commands.
        first: the first step with a number that differs by more; None if they agree.
    """

    agree: bool
    steps: int
    corrected: int
    largest: NDArray[np.float64]
    first: Crossing | None

    def __str__(self) -> str:
        """Say it in one sentence."""
        apart = f"{self.corrected} steps were corrected and are left out" if self.corrected else "no step was corrected"
        if self.first is None:
            off = f"off by {self.largest.max():.2g} of the span at most"
            return f"both routes command the same: {self.steps} steps, {off}; {apart}"
        number = int(np.argmax(np.abs(self.first.ours - self.first.theirs)))
        return (
            f"the routes differ, first at step {self.first.step}: number {number} of the command is "
            f"{self.first.ours[number]:.6g} through adapter and environment, and {self.first.theirs[number]:.6g} by "
            f"the authors' client; {apart}"
        )


class Bridge:
    """An environment whose every command is compared with that of the authors' client.

    Drive it as the environment itself, for example with `xpl.rollout.run_episode`. The client is asked at every control
    step with what the simulator observed then, and has to execute as many actions of a chunk as the loop does.

    Args:
        task_env: the only environment of its process; it has `simulated()`, which returns `Simulated`
            (`xpl.Episode.simulated` for environments of the SDK).
        client: the authors': takes the simulator's observation and the instruction, and returns a command (N,). Its
            `reset`, if it has one, is called when an episode begins.
    """

    def __init__(self, task_env: Any, client: Callable[[Any, str], Any]) -> None:
        self._env, self._client = task_env, client
        self._instruction = ""
        self._steps = 0
        self.crossings: list[Crossing] = []

    def __getattr__(self, name: str) -> Any:
        """Return what the environment offers besides."""
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
        """Ask the authors' client, execute the adapter's action, and keep what both commanded.

        Raises:
            BridgeError: if the environment does not say what its simulator observes and was told, or the client answers
                a command of another size.
        """
        theirs = _command(self._client(self._simulated().observation, self._instruction), "the authors' client")
        report = self._env.take_action(action)
        ours = _command(self._simulated().command, "the simulator")
        if ours.shape != theirs.shape:
            raise BridgeError(
                f"the simulator was told {ours.size} numbers, the authors' client commands {theirs.size}: both have to "
                "be the simulator's own command"
            )
        corrected = bool(isinstance(report, Mapping) and report.get(CORRECTIONS))
        self.crossings.append(Crossing(self._steps, ours, theirs, corrected))
        self._steps += 1
        return report

    def verdict(self, tolerance: float = 1e-3) -> Verdict:
        """Return what the steps so far come to.

        Args:
            tolerance: largest difference of a number, as a share of the span of what the authors' client commands.

        Raises:
            BridgeError: if no step can be compared.
        """
        compared = [one for one in self.crossings if not one.corrected]
        if not compared:
            raise BridgeError(f"no step can be compared: {len(self.crossings)} were executed, all corrected")
        theirs = np.stack([one.theirs for one in compared])
        span = np.ptp(theirs, axis=0)
        span[span == 0] = np.maximum(np.abs(theirs[0]), 1.0)[span == 0]
        shares = np.abs(np.stack([one.ours for one in compared]) - theirs) / span
        off = ~(shares <= tolerance).all(axis=1)  # what is no number differs
        first = compared[int(np.argmax(off))] if off.any() else None
        return Verdict(first is None, len(compared), len(self.crossings) - len(compared), shares.max(axis=0), first)

    def _simulated(self) -> Simulated:
        tell = getattr(self._env, "simulated", None)
        told = tell() if callable(tell) else None
        if not isinstance(told, Simulated):
            raise BridgeError(
                f"{type(self._env).__name__} does not say what its simulator observes and was told: its episode needs "
                "`simulated()`, which returns xpl.bridge.Simulated"
            )
        return told


def _command(given: object, whose: str) -> NDArray[np.float64]:
    try:
        return np.asarray(given, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise BridgeError(f"{whose} must say a command as numbers, got {type(given).__name__}") from None
