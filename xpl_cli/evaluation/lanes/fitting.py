"""Keeps from an environment what is no action of its robot, whoever made it up: a loop, or a model behind a server.

An environment breaks over it in its own way. That would look like a failure of the environment, and the episode would
be played again: a policy could have that where it is about to lose.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl.action import check_form

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.embodiment import Embodiment


class Fitting:
    """A task environment that is given nothing but actions of its robot, of whatever values.

    Args:
        task_env: the environment; whatever it offers besides is passed on.
        embodiment: its robot.
        action_type: how it is driven.
    """

    def __init__(self, task_env: Any, embodiment: Embodiment, action_type: str) -> None:
        self._env = task_env
        self._robot = embodiment, action_type

    def __getattr__(self, name: str) -> Any:
        """Return what the environment offers besides."""
        return getattr(self._env, name)

    def take_action(self, action: Any) -> Any:
        """Execute an action step.

        Raises:
            ActionError: it is none of this robot; the environment has not seen it.
        """
        check_form(action, *self._robot)
        return self._env.take_action(action)

    def take_action_batch(self, actions: Sequence[Any], env_idx_list: Sequence[int]) -> Any:
        """Execute an action step of each environment in the list.

        Raises:
            ActionError: one is none of this robot; no environment has seen any.
        """
        for action in actions:
            check_form(action, *self._robot)
        return self._env.take_action_batch(actions, env_idx_list)
