"""The adapter's own evaluation loop in physics: does it run an episode to its end, and no further?"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl.client import ClientError, PolicyServerError
from xpl_cli.audit.rules.model import NotApplicable
from xpl_cli.basics.errors import NotFoundError
from xpl_cli.evaluation.loop.process import AdapterLoop, LoopRaisedError
from xpl_cli.evaluation.loop.request_handler import EndlessLoopError, LoopError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from xpl.contract import Action, ObservationDict, Report
    from xpl.environment import TaskEnv
    from xpl_cli.audit.rules.options import AuditOptions
    from xpl_cli.audit.served.recorded_client import Answer, RecordedClient

_IMPORT_ERRORS = (ImportError.__name__, ModuleNotFoundError.__name__)


@dataclass
class ShortenedEnv:
    """A task environment with given episode lengths, which counts actions after their end.

    Attributes:
        env: the real environment, reset.
        lengths: per environment, control steps after which its episode ends.
        steps: per environment, control steps that were executed.
        late: actions for environments whose episode had ended.
    """

    env: TaskEnv
    lengths: Sequence[int]
    steps: list[int] = field(default_factory=list)
    late: int = 0

    def __post_init__(self) -> None:
        """Start at step 0."""
        self.steps = [0] * len(self.lengths)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.env, name)

    def get_running_env_idx_list(self) -> list[int]:
        """Return the indices of environments whose episode is running."""
        return [env for env in self.env.get_running_env_idx_list() if self.steps[env] < self.lengths[env]]

    def is_episode_end(self) -> bool:
        """Return whether all episodes have ended."""
        return not self.get_running_env_idx_list()

    def get_obs_batch(
        self,
        env_idx_list: Sequence[int] | None = None,
        last_frame: bool = False,  # noqa: FBT001, FBT002 - as loops pass it
    ) -> list[ObservationDict]:
        """Return observations of some environments, by default of all running ones."""
        indices = self.get_running_env_idx_list() if env_idx_list is None else env_idx_list
        return self.env.get_obs_batch(indices, last_frame)

    def take_action(self, action: Action) -> Report:
        """Execute one action step in the only environment."""
        return self.take_action_batch([action], [0])[0]

    def take_action_batch(self, actions: Sequence[Action], env_idx_list: Sequence[int]) -> list[Report]:
        """Execute one action step in some environments, except those that have ended."""
        running = self.get_running_env_idx_list()
        ended = [env for env in env_idx_list if env not in running]
        self.late += len(ended)
        reports: list[Report] = self.env.take_action_batch(actions, env_idx_list)
        for env in env_idx_list:
            if env in running:
                self.steps[env] += 1
        return reports


@dataclass(frozen=True)
class LoopClient:
    """The policy client for an evaluation loop."""

    session: RecordedClient

    def call(self, func_name: str, obs: object = None) -> Answer:
        """Run an operation of the policy.

        Raises:
            PolicyServerError: if the policy raises an error.
        """
        answer = self.session.call(func_name, obs)
        if isinstance(answer, PolicyServerError):
            raise answer
        return answer


@contextlib.contextmanager
def adapter_loop(folder: Path, options: AuditOptions) -> Iterator[AdapterLoop]:
    """Provide the evaluation loops of an adapter's deploy.py, in a process that ends with the `with` block.

    Args:
        folder: of the adapter.
        options: options of the audit, with its isolation.

    Raises:
        NotApplicable: if there is none.
    """
    with contextlib.ExitStack() as stack:
        isolation = stack.enter_context(options.bounds.isolate_adapter(folder))
        try:
            loop = AdapterLoop(folder, isolation=isolation, is_silent=True)
        except NotFoundError as error:
            raise NotApplicable(str(error)) from None
        stack.callback(loop.close)
        yield loop


def run_loop(loop: AdapterLoop, env: ShortenedEnv, session: RecordedClient, *, batch: bool) -> str | None:
    """Run a loop and return its problem, or None.

    Raises:
        NotApplicable: if there is no such loop, or it needs a library that is not installed here.
    """
    try:
        loop.load(batch=batch)
    except NotFoundError as error:
        raise NotApplicable(str(error)) from None
    except LoopRaisedError as error:
        if error.kind in _IMPORT_ERRORS:
            raise NotApplicable(f"{sdk.File.DEPLOY_PY} cannot be imported here: {error.message}") from None
        return f"cannot be imported: {error.kind}: {error.message}"
    except LoopError as error:
        return f"cannot be imported: {error}"
    return _loop_error(loop, env, session, batch=batch) or _wrong_length(env)


def _loop_error(loop: AdapterLoop, env: ShortenedEnv, session: RecordedClient, *, batch: bool) -> str | None:
    try:
        loop.run_trial(env, LoopClient(session), batch=batch)
    except EndlessLoopError:
        return "does not detect the end of the episode, and never returns"
    except ClientError as error:
        return f"fails, because the policy cannot be reached: {error}"
    except LoopRaisedError as error:
        return f"fails: {error.kind}: {error.message}"
    except LoopError as error:
        return f"fails: {error}"
    except Exception as error:  # noqa: BLE001 - what the environment refused
        return f"fails: {type(error).__name__}: {error}"
    return None


def _wrong_length(env: ShortenedEnv) -> str | None:
    short = [env for env, (done, length) in enumerate(zip(env.steps, env.lengths, strict=True)) if done < length]
    if short:
        steps = env.steps[short[0]]
        return f"returns before the episode has ended, after {steps} of {env.lengths[short[0]]} steps"
    if env.late:
        return "executes actions of an episode that has ended"
    return None
