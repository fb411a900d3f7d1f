"""ManiSkill's own motion planners, executed one step at a time."""

from __future__ import annotations

import contextlib
import importlib
import sys
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

# Without DrawTriangle's, which ends with a TypeError in ManiSkill's own loop, too.
_SOLVERS = {
    "panda": {
        "PickCube": "solvePickCube",
        "StackCube": "solveStackCube",
        "PegInsertionSide": "solvePegInsertionSide",
        "PlugCharger": "solvePlugCharger",
        "PlaceSphere": "solvePlaceSphere",
        "PushCube": "solvePushCube",
        "PullCubeTool": "solvePullCubeTool",
        "LiftPegUpright": "solveLiftPegUpright",
        "PullCube": "solvePullCube",
        "StackPyramid": "solveStackPyramid",
    },
    "so100": {"PickCubeSO100": "solvePickCube"},
}


def solver(task: str) -> Callable[..., Any] | None:
    """Return ManiSkill's planner of a task, or None if it has none."""
    for robot, tasks in _SOLVERS.items():
        if task in tasks:
            module = importlib.import_module(f"mani_skill.examples.motionplanning.{robot}.solutions")
            solve: Callable[..., Any] = getattr(module, tasks[task])
            return solve
    return None


class _OverError(BaseException):
    """The episode is over; no planner catches it."""


class _Scene:
    """The simulation as a planner sees it: it plans for angles, whatever the arm is commanded by."""

    control_mode = "pd_joint_pos"

    def __init__(self, env: Any) -> None:
        self._env = env

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)


class Planner:
    """Runs a planner beside an episode: the two take turns, and never run at the same time.

    A planner is a program that steps its environment until it is done. Here it runs in a thread of its own, and
    each of its steps waits until the episode has made one.

    Args:
        solve: ManiSkill's.
        env: the simulation.

    Attributes:
        command: its present command: angles, then its gripper's command; None before its first step. After its end or
            failure it stays at the last command.
    """

    def __init__(self, solve: Callable[..., Any], env: Any) -> None:
        self._solve, self.unwrapped = solve, _Scene(env)
        self._thread: threading.Thread | None = None
        self.command: np.ndarray | None = None

    def begin(self) -> None:
        """Begin an episode: plan up to the first step."""
        self.end()
        self.command, self._is_leaving = None, False
        self._its_turn, self._our_turn = threading.Semaphore(0), threading.Semaphore(0)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        self._go_on()

    def stepped(self, outcome: Any) -> None:
        """Report a step of the episode with ManiSkill's return value; let the planner continue to the next."""
        self._outcome = outcome
        if self._thread is not None and self._thread.is_alive():
            self._go_on()

    def end(self) -> None:
        """Leave the planner wherever it is."""
        if self._thread is not None and self._thread.is_alive():
            self._is_leaving = True
            self._its_turn.release()
            self._thread.join()
        self._thread = None

    def reset(self, **_: Any) -> None:
        """Do nothing: the episode has begun. Planners call it first."""

    def step(self, command: Any) -> Any:
        """Wait until the episode has made a step, and return what ManiSkill returned."""
        self.command = np.asarray(command, dtype=np.float64)
        self._our_turn.release()
        self._its_turn.acquire()
        if self._is_leaving:
            raise _OverError
        return self._outcome

    def _go_on(self) -> None:
        with contextlib.redirect_stdout(sys.stderr):  # planners print
            self._its_turn.release()
            self._our_turn.acquire()

    def _run(self) -> None:
        self._its_turn.acquire()
        try:
            self._solve(self, seed=None, debug=False, vis=False)
        except _OverError:
            return
        except Exception as error:  # noqa: BLE001 - a planner that finds no way raises whatever follows from that
            sys.stderr.write(f"ManiSkill's planner stopped: {type(error).__name__}: {error}\n")
        finally:
            self._our_turn.release()
