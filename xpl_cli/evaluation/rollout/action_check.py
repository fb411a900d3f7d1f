"""Reject invalid actions of a loop or a model before they reach the environment.

An environment that receives an invalid action fails in its own way. That would count as an infrastructure error and the
episode would be retried, which a policy could provoke whenever it is about to fail.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl.action import check_form
from xpl_cli.evaluation.rollout.env_wrapper import TaskEnvWrapper

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.contract import Action
    from xpl.embodiment import Embodiment
    from xpl.environment import TaskEnv


class ActionCheckWrapper(TaskEnvWrapper):
    """A task environment that receives only valid actions of its robot, of whatever values.

    Args:
        task_env: the environment.
        embodiment: its robot.
        action_type: "joint" or "ee".
    """

    def __init__(self, task_env: TaskEnv, embodiment: Embodiment, action_type: str) -> None:
        super().__init__(task_env)
        self._robot = embodiment, action_type

    def _before_step(self, actions: Sequence[Action], envs: Sequence[int]) -> None:  # noqa: ARG002 - all have the same robot
        """Raise an ActionError for what is no action of this robot; no environment has seen any."""
        for action in actions:
            check_form(action, *self._robot)
