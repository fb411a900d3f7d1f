"""The adapter's own evaluation loop, run in physics: does it play an episode to its end, and no further?"""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl.client import ClientError, PolicyServerError
from xpl_cli.audit.rules.model import NotApplicable
from xpl_cli.basics.errors import NotFoundError
from xpl_cli.evaluation import play

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from xpl_cli.audit.served.session import Session

_PATIENCE = 100
"""Calls of the environment after the end, none of which notices it, after which a loop is taken to go on for ever."""


class EndlessError(Exception):
    """A loop does not notice that its episodes have ended."""


@dataclass
class Stage:
    """A task environment that ends its episodes when it is told to, and notes who goes on.

    Attributes:
        env: the real one, reset.
        lengths: per environment, control steps after which its episode ends.
        steps: per environment, control steps that were executed.
        late: actions for environments whose episode had ended.
    """

    env: Any
    lengths: Sequence[int]
    steps: list[int] = field(default_factory=list)
    late: int = 0
    _calls: int = 0

    def __post_init__(self) -> None:
        """Begin."""
        self.steps = [0] * len(self.lengths)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.env, name)

    def get_running_env_idx_list(self) -> list[int]:
        """Return the environments whose episode goes on."""
        running = self._running()
        if running:
            self._calls = 0
        return running

    def is_episode_end(self) -> bool:
        """Return whether all episodes have ended."""
        return not self.get_running_env_idx_list()

    def get_obs(self) -> dict[str, Any]:
        """Return the observation of the only environment."""
        self._noticed()
        obs: dict[str, Any] = self.env.get_obs()
        return obs

    def get_obs_batch(self, env_idx_list: Sequence[int] | None = None, *args: Any, **options: Any) -> Any:
        """Return observations of some environments, by default of those that run."""
        self._noticed()
        wanted = self._running() if env_idx_list is None else env_idx_list
        return self.env.get_obs_batch(wanted, *args, **options)

    def take_action(self, action: Mapping[str, Any]) -> Any:
        """Execute one action step in the only environment."""
        return self.take_action_batch([action], [0])[0]

    def take_action_batch(self, actions: Sequence[Mapping[str, Any]], env_idx_list: Sequence[int]) -> Any:
        """Execute one action step in some environments; none in those that have ended."""
        self._noticed()
        running = self._running()
        ended = [env for env in env_idx_list if env not in running]
        self.late += len(ended)
        reports = self.env.take_action_batch(actions, env_idx_list)
        for env in env_idx_list:
            if env in running:
                self.steps[env] += 1
        return reports

    def _running(self) -> list[int]:
        return [env for env in self.env.get_running_env_idx_list() if self.steps[env] < self.lengths[env]]

    def _noticed(self) -> None:
        """Count calls after the end.

        Raises:
            EndlessError: if there were too many of them.
        """
        self._calls = 0 if self._running() else self._calls + 1
        if self._calls > _PATIENCE:
            raise EndlessError


@dataclass(frozen=True)
class LoopClient:
    """What an evaluation loop calls the policy by."""

    session: Session

    def call(self, func_name: str, obs: Any = None) -> Any:
        """Run an operation of the policy.

        Raises:
            PolicyServerError: in place of an answer.
        """
        answer = self.session.call(func_name, obs)
        if isinstance(answer, PolicyServerError):
            raise answer
        return answer


def loop_of(folder: Path, *, batch: bool) -> Callable[[Any, Any], None]:
    """Return the evaluation loop of an adapter's deploy.py.

    Raises:
        NotApplicable: if there is none, or it needs what is not installed here.
    """
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            return play.load_loop(folder, batch=batch)
    except NotFoundError as error:
        raise NotApplicable(str(error)) from None
    except ImportError as error:
        raise NotApplicable(f"{sdk.File.DEPLOY_PY} cannot be imported here: {error}") from None


def problem_of(loop: Callable[[Any, Any], None], stage: Stage, session: Session) -> str | None:
    """Run a loop and return what is wrong with how it plays, or None."""
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            loop(stage, LoopClient(session))
    except EndlessError:
        return "does not notice that the episode has ended, and goes on for ever"
    except ClientError as error:
        return f"breaks off, because the policy cannot be asked: {error}"
    except Exception as error:  # noqa: BLE001 - whatever the adapter's code raises
        return f"breaks off: {type(error).__name__}: {error}"
    short = [env for env, (done, length) in enumerate(zip(stage.steps, stage.lengths, strict=True)) if done < length]
    if short:
        left = stage.steps[short[0]]
        return f"returns before the episode has ended, after {left} of {stage.lengths[short[0]]} steps"
    if stage.late:
        return "executes actions of an episode that has ended"
    return None
