"""The base class of XPolicyLab's adapters."""

from __future__ import annotations

from typing import Any

from xpl import _spec as spec


class ModelTemplate:
    """Base class of adapters; they override the methods that they support.

    Attributes:
        model: the adapter's own model.
    """

    def __init__(self, *_: Any, **__: Any) -> None:
        self.model: Any = None

    def update_obs(self, obs: Any) -> Any:  # noqa: ARG002 - of the interface
        """Add an observation."""
        raise self._unwritten(spec.Method.UPDATE_OBS)

    def update_obs_batch(self, obs_list: Any) -> Any:  # noqa: ARG002 - of the interface
        """Add one observation of each of several environments."""
        raise self._unwritten(spec.Method.UPDATE_OBS_BATCH)

    def get_action(self) -> Any:
        """Return an action chunk."""
        raise self._unwritten(spec.Method.GET_ACTION)

    def get_action_batch(self, env_idx_list: Any = None) -> Any:  # noqa: ARG002 - as above
        """Return an action chunk for each environment of the list."""
        raise self._unwritten(spec.Method.GET_ACTION_BATCH)

    def reset(self) -> Any:
        """Start a new episode."""

    def prepare_case(self, case_meta: Any = None) -> Any:
        """Receive the metadata of the next case."""

    def on_trial_end(self, result: Any = None) -> Any:
        """Receive the result of a trial."""

    def _unwritten(self, name: str) -> NotImplementedError:
        return NotImplementedError(f"{type(self).__name__} has no {name}: write it in model.py")
