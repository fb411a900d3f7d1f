"""What a policy learns about a trial: the case before it, and the outcome after it (`prepare_case`, `on_trial_end`).

That includes neither seed nor layout, and the trial's name is random: a policy must not look up what is evaluated.
"""

from __future__ import annotations

import uuid
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl.client import ClientError, PolicyServerError
from xpl_cli.basics import console

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl import Client
    from xpl.contract import Payload
    from xpl_cli.evaluation.records.model import EpisodeOutcome
    from xpl_cli.evaluation.rollout.config import EnvSettings

_REPORTED = ("success", "score", "steps", "end_reason")
_UNKNOWN = (sdk.ErrorCode.UNKNOWN_MESSAGE_TYPE, sdk.ErrorCode.INVALID_FRAME)


def describe_case(settings: EnvSettings) -> Payload:
    """Return the description of a case, with its name; `settings` are those of the environment."""
    return {
        sdk.Payload.ACTION_CASE_ID: f"{settings.task}/{settings.setting}",
        sdk.Deploy.TASK_NAME: settings.task,
        "setting": settings.setting,
        sdk.Deploy.ENV_CFG_TYPE: settings.embodiment,
        sdk.Deploy.ACTION_TYPE: settings.action_type,
        "num_envs": settings.num_envs,
    }


def describe_outcome(outcomes: Sequence[EpisodeOutcome]) -> Payload:
    """Return the outcome of a trial: of one episode as a map, of several as a list."""
    results = [{name: getattr(outcome, name) for name in _REPORTED} for outcome in outcomes]
    return results[0] if len(results) == 1 else {"results": results}


def begin(client: Client, case: Payload) -> None:
    """Announce a trial to the policy; a server that does not know how is left alone.

    Raises:
        ClientError: the policy's hook raised, or the connection failed.
    """
    client.trial_id = uuid.uuid4().hex
    try:
        client.prepare_case(**case)
    except PolicyServerError as error:
        if error.code not in _UNKNOWN:
            raise


def end(client: Client, outcomes: Sequence[EpisodeOutcome]) -> bool:
    """Report the outcome to the policy; return whether the connection can be used for the next trial.

    The result stands whatever the policy's hook does: its errors are printed.
    """
    try:
        client.trial_end(describe_outcome(outcomes))
    except PolicyServerError as error:
        if error.code not in _UNKNOWN:
            console.note(f"the policy's on_trial_end failed: {error}")
        return not error.is_infrastructure_error
    except ClientError:
        return False
    return True
