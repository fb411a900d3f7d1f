"""Scripted expert for the tasks of `envs/mujoco`: Cartesian programs on privileged observations, no learning."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from xpl import Policy
from xpl import _spec as spec
from xpl.observation import ObservationError, pack_state

from .cell import Cell, Hand, Program


class Model(Policy):
    """Runs the program of the observed task, one per environment."""

    def load(self, config: Mapping[str, Any]) -> None:
        """Start without programs; they begin with the first observation of an episode."""
        self._running: dict[int, tuple[Cell, Program]] = {}

    def encode(self, obs: Mapping[str, Any], env: int) -> tuple[Mapping[str, Any], np.ndarray]:
        """Return the ground truth of the scene and the joints (D,)."""
        truth = obs.get(spec.Obs.PRIVILEGED)
        if not isinstance(truth, Mapping):
            raise ObservationError(
                f"scripted_expert plans from the {spec.Obs.PRIVILEGED!r} map of the observation, which is missing: "
                f"ask the environment for privileged observations"
            )
        return truth, pack_state(obs, self.embodiment, spec.ACTION_TYPES[0])

    def predict(self, inputs: list[Any], envs: list[int]) -> np.ndarray:
        """Advance each environment's program by one step; return action chunks (B, 1, D)."""
        return np.stack([row[None] for row in map(self._advance, envs, inputs)])

    def reset_env(self, env: int) -> None:
        """Drop the environment's program."""
        self._running.pop(env, None)

    def _advance(self, env: int, entry: tuple[Mapping[str, Any], np.ndarray]) -> np.ndarray:
        truth, joints = entry
        if env not in self._running:
            self._running[env] = self._begin(truth, joints)
        cell, program = self._running[env]
        cell.see(truth, joints)
        next(program, None)  # a program that has ended keeps its last targets
        return np.concatenate([self._command(hand) for hand in cell.hands])

    def _begin(self, truth: Mapping[str, Any], joints: np.ndarray) -> tuple[Cell, Program]:
        task = truth["task"]
        known = programs()
        if task not in known:
            raise ObservationError(f"scripted_expert has no program for task {task!r}; it knows {', '.join(known)}")
        hands, at = [], 0
        for arm in self.embodiment.arms:
            base = np.array(truth[arm.prefix + spec.State.BASE_POSE], dtype=np.float64)
            hands.append(Hand(self.embodiment.data, base, joints[at : at + arm.dof], float(joints[at + arm.dof])))
            at += arm.dof + arm.ee_dim
        cell = Cell(hands, truth)
        program: Program = importlib.import_module(f".programs.{task}", __package__).program(cell)
        return cell, program

    def _command(self, hand: Hand) -> np.ndarray:
        hand.follow()
        arm = hand.joints if self.action_type == spec.ACTION_TYPES[0] else hand.flange()
        return np.append(arm, hand.opening)


def programs() -> list[str]:
    """Return the names of the tasks that have a program."""
    return sorted(file.stem for file in Path(__file__).with_name("programs").glob("*.py"))
