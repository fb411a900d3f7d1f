"""What a policy is told of a trial: the case before it, and how it went after it (`prepare_case`, `on_trial_end`).

Nothing of a seed or a layout is among it, and the name of a trial tells nothing: what is played is not to be looked up.
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
    """Return what is told of a case, its name among it; `settings` are those of the environment."""
    return {
        sdk.Payload.ACTION_CASE_ID: f"{settings.task}/{settings.setting}",
        sdk.Deploy.TASK_NAME: settings.task,
        "setting": settings.setting,
        sdk.Deploy.ENV_CFG_TYPE: settings.embodiment,
        sdk.Deploy.ACTION_TYPE: settings.action_type,
        "num_envs": settings.num_envs,
    }


def describe_outcome(endings: Sequence[EpisodeOutcome]) -> Payload:
    """Return what is told of how a trial went: of one episode as it is, of several as a list."""
    results = [{name: getattr(ending, name) for name in _REPORTED} for ending in endings]
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


def end(client: Client, endings: Sequence[EpisodeOutcome]) -> bool:
    """Tell the policy how a trial went; return whether the connection can be used for the next one.

    The verdict stands whatever the policy's hook does: what it raises is told to whoever watches.
    """
    try:
        client.trial_end(describe_outcome(endings))
    except PolicyServerError as error:
        if error.code not in _UNKNOWN:
            console.note(f"the policy's on_trial_end failed: {error}")
        return not error.is_infrastructure_error
    except ClientError:
        return False
    return True
