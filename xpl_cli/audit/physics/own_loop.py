"""The adapter's own evaluation loop, run in physics: does it play an episode to its end, and no further?"""

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

_LACKING = (ImportError.__name__, ModuleNotFoundError.__name__)


@dataclass
class Stage:
    """A task environment that ends its episodes when it is told to, and notes who goes on.

    Attributes:
        env: the real one, reset.
        lengths: per environment, control steps after which its episode ends.
        steps: per environment, control steps that were executed.
        late: actions for environments whose episode had ended.
    """

    env: TaskEnv
    lengths: Sequence[int]
    steps: list[int] = field(default_factory=list)
    late: int = 0

    def __post_init__(self) -> None:
        """Begin."""
        self.steps = [0] * len(self.lengths)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.env, name)

    def get_running_env_idx_list(self) -> list[int]:
        """Return the environments whose episode goes on."""
        return [env for env in self.env.get_running_env_idx_list() if self.steps[env] < self.lengths[env]]

    def is_episode_end(self) -> bool:
        """Return whether all episodes have ended."""
        return not self.get_running_env_idx_list()

    def get_obs_batch(
        self,
        env_idx_list: Sequence[int] | None = None,
        last_frame: bool = False,  # noqa: FBT001, FBT002 - as loops pass it
    ) -> list[ObservationDict]:
        """Return observations of some environments, by default of those that run."""
        wanted = self.get_running_env_idx_list() if env_idx_list is None else env_idx_list
        return self.env.get_obs_batch(wanted, last_frame)

    def take_action(self, action: Action) -> Report:
        """Execute one action step in the only environment."""
        return self.take_action_batch([action], [0])[0]

    def take_action_batch(self, actions: Sequence[Action], env_idx_list: Sequence[int]) -> list[Report]:
        """Execute one action step in some environments; none in those that have ended."""
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
    """What an evaluation loop calls the policy by."""

    session: RecordedClient

    def call(self, func_name: str, obs: object = None) -> Answer:
        """Run an operation of the policy.

        Raises:
            PolicyServerError: in place of an answer.
        """
        answer = self.session.call(func_name, obs)
        if isinstance(answer, PolicyServerError):
            raise answer
        return answer


@contextlib.contextmanager
def loop_of(folder: Path, options: AuditOptions) -> Iterator[AdapterLoop]:
    """Give the evaluation loops of an adapter's deploy.py, in a process that ends with the `with` block.

    Args:
        folder: of the adapter.
        options: how it is audited, and kept within bounds.

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


def problem_of(loop: AdapterLoop, stage: Stage, session: RecordedClient, *, batch: bool) -> str | None:
    """Run a loop and return what is wrong with how it plays, or None.

    Raises:
        NotApplicable: there is no such loop, or it needs what is not installed here.
    """
    try:
        loop.load(batch=batch)
    except NotFoundError as error:
        raise NotApplicable(str(error)) from None
    except LoopRaisedError as error:
        if error.kind in _LACKING:
            raise NotApplicable(f"{sdk.File.DEPLOY_PY} cannot be imported here: {error.message}") from None
        return f"cannot be imported: {error.kind}: {error.message}"
    except LoopError as error:
        return f"cannot be imported: {error}"
    return _broken_off(loop, stage, session, batch=batch) or _misplayed(stage)


def _broken_off(loop: AdapterLoop, stage: Stage, session: RecordedClient, *, batch: bool) -> str | None:
    try:
        loop.run_trial(stage, LoopClient(session), batch=batch)
    except EndlessLoopError:
        return "does not notice that the episode has ended, and goes on for ever"
    except ClientError as error:
        return f"breaks off, because the policy cannot be asked: {error}"
    except LoopRaisedError as error:
        return f"breaks off: {error.kind}: {error.message}"
    except LoopError as error:
        return f"breaks off: {error}"
    except Exception as error:  # noqa: BLE001 - what the environment refused
        return f"breaks off: {type(error).__name__}: {error}"
    return None


def _misplayed(stage: Stage) -> str | None:
    short = [env for env, (done, length) in enumerate(zip(stage.steps, stage.lengths, strict=True)) if done < length]
    if short:
        left = stage.steps[short[0]]
        return f"returns before the episode has ended, after {left} of {stage.lengths[short[0]]} steps"
    if stage.late:
        return "executes actions of an episode that has ended"
    return None
