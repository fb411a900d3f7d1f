"""What every task shares: staged score, and success that must hold."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from .physics import Physics
    from .scene import Scene


class Task(ABC):
    """One task in one episode.

    A task declares its numbers in `env.yml` (instruction, steps, weights of its stages) and its meaning in a subclass.
    The last stage is success: it is reached when `solved` held, with every object at rest, for the number of control
    steps that the manifest asks for. A stage, once reached, stays reached.

    Args:
        facts: the task's entry in the manifest.
        success: the manifest's `success` entry.

    Attributes:
        objects: names of the free bodies that must be at rest.
        stages: whether each stage has been reached, in order.
        words: what stands for the names in braces in the instruction; known once the scene is laid out.
        clear: places (2,) where nothing may stand in the way, besides those where objects and markers are; likewise.
    """

    objects: tuple[str, ...] = ()

    def __init__(self, facts: Mapping[str, Any], success: Mapping[str, Any]) -> None:
        self._weights: dict[str, float] = dict(facts["stages"])
        self._success = success
        self._held = 0
        self.stages = dict.fromkeys(self._weights, False)
        self.words: dict[str, str] = {}
        self.clear: list[NDArray[np.float64]] = []
        *self._on_the_way, self._goal = self._weights

    @abstractmethod
    def lay_out(self, scene: Scene, rng: np.random.Generator) -> None:
        """Add objects and goals to the scene; `rng` is the only source of variation."""

    @abstractmethod
    def reached(self, physics: Physics) -> dict[str, bool]:
        """Return, for each stage before the last, whether its condition is met at this moment."""

    @abstractmethod
    def solved(self, physics: Physics) -> bool:
        """Return whether the goal's condition is met at this moment, rest aside."""

    def act(self, physics: Physics) -> None:  # noqa: B027 - most tasks leave the world alone
        """Let the world do what it does by itself after a control step."""

    @abstractmethod
    def truth(self, physics: Physics) -> dict[str, Any]:
        """Return objects and goals for privileged observations."""

    @property
    def succeeded(self) -> bool:
        """Whether the task has been solved."""
        return self.stages[self._goal]

    @property
    def score(self) -> float:
        """Sum of the weights of the stages reached; 1 on success, however it came about."""
        return 1.0 if self.succeeded else float(sum(self._weights[name] for name, done in self.stages.items() if done))

    def update(self, physics: Physics) -> None:
        """Judge the state after a control step."""
        self.act(physics)
        now = self.reached(physics)
        for name in self._on_the_way:
            self.stages[name] = self.stages[name] or now[name]
        self._held = self._held + 1 if self.solved(physics) and self._at_rest(physics) else 0
        self.stages[self._goal] = self.succeeded or self._held >= self._success["hold_steps"]

    def _at_rest(self, physics: Physics) -> bool:
        speeds = [physics.body_speed(name) for name in self.objects]
        limit, spin = self._success["resting_speed"], self._success["resting_spin"]
        return all(moving < limit and turning < spin for moving, turning in speeds)


def load_task(name: str) -> type[Task]:
    """Return the class of a task: what `tasks/<name>.py` calls TASK."""
    module = importlib.import_module(f".tasks.{name}", __package__)
    task_class: type[Task] = module.TASK
    return task_class
