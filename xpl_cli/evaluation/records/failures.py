"""Whose failure it was: the task's, the policy's or the infrastructure's (`failure` of a recorded episode)."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

from xpl.safety import FAR_FIRST_ACTION, NON_FINITE
from xpl.vector import INFRASTRUCTURE
from xpl_cli.evaluation.records.model import EpisodeOutcome

if TYPE_CHECKING:
    from xpl.contract import Result
    from xpl_cli.evaluation.records.model import EpisodeRecord

TASK, POLICY = "task", "policy"
POLICY_ERROR, POLICY_DIED = "policy_error", "policy_died"
"""`end_reason` where the policy's side raised or answered with nonsense, and where its process ended or hung."""
SUCCESS, MAX_STEPS = "success", "max_steps"
MAX_INFRASTRUCTURE_SHARE = 0.1
"""Most infrastructure errors of a run, as a share of its episodes; with more it is neither ranked nor bundled."""
SUCCESS_OF = {None: (True, None), TASK: (False,), POLICY: (False, None), INFRASTRUCTURE: (None,)}
"""What `success` may be for each class of failure."""
_GUARDED = (FAR_FIRST_ACTION, NON_FINITE)
_NO_SUCCESS = (None, MAX_STEPS, POLICY_ERROR, POLICY_DIED, INFRASTRUCTURE, *_GUARDED)
_REPORTED = {item.name for item in fields(EpisodeOutcome)} - {"failure", "error"}
_INFRASTRUCTURE_ENDING: dict[str, Any] = {
    "success": None,
    "score": None,
    "failure": INFRASTRUCTURE,
    "end_reason": INFRASTRUCTURE,
}
_UNFINISHED = "the evaluation loop returned before the episode had ended"


def outcome_of(result: Result) -> EpisodeOutcome:
    """Return the outcome of an episode whose loop returned, from the environment's result.

    Without a success criterion (success None) there is no failure either.
    """
    outcome = _ending_of(result)
    if outcome.end_reason == INFRASTRUCTURE:
        return replace(outcome, **_INFRASTRUCTURE_ENDING, error=str(result.get("error") or "the environment was lost"))
    if outcome.success or outcome.success is None:
        return outcome
    if outcome.end_reason is None:
        return policy_error(result, _UNFINISHED)
    if outcome.end_reason in _GUARDED:
        return replace(outcome, failure=POLICY, error=f"a guard ended the episode: {outcome.end_reason}")
    return replace(outcome, failure=TASK)


def policy_error(result: Result, reason: str) -> EpisodeOutcome:
    """Return the outcome of an episode that the policy broke off: no success, and the score until then."""
    return replace(_ending_of(result), success=False, failure=POLICY, end_reason=POLICY_ERROR, error=reason)


def policy_crash(result: Result, reason: str) -> EpisodeOutcome:
    """Return the outcome if a process with the adapter's code ended or hung: a failure of the policy.

    It may be retried, because machines do kill processes; an episode without a finished attempt has failed.
    """
    return replace(policy_error(result, reason), end_reason=POLICY_DIED)


def may_retry(outcome: EpisodeOutcome) -> bool:
    """Return whether another attempt may follow this outcome."""
    return outcome.failure == INFRASTRUCTURE or (outcome.failure == POLICY and outcome.end_reason == POLICY_DIED)


def contradiction(outcome: EpisodeRecord) -> str | None:
    """Return in what an episode contradicts itself about success, or None."""
    if outcome.success is False:
        return "did not succeed, but ended with success" if outcome.end_reason == SUCCESS else None
    if not outcome.success:
        return None
    against = {
        f"with a failure of the class {outcome.failure}": outcome.failure is not None,
        f"but ended with {outcome.end_reason or 'nothing'}": outcome.end_reason in _NO_SUCCESS,
        "with a score of 0": outcome.score == 0,
        "but reached no stage": outcome.stages and not any(outcome.stages.values()),
        "after 0 steps": outcome.steps == 0,
        "without a request to the policy": outcome.inference is not None and outcome.inference.count == 0,
    }
    problem = next((text for text, holds in against.items() if holds), None)
    return None if problem is None else f"succeeded, {problem}"


def infrastructure_error(reason: str) -> EpisodeOutcome:
    """Return the outcome of an attempt that ended with an infrastructure error."""
    return EpisodeOutcome(**_INFRASTRUCTURE_ENDING, error=reason)


def _ending_of(result: Result) -> EpisodeOutcome:
    """Return the outcome in an environment's result; the failure is attributed elsewhere."""
    return EpisodeOutcome(**{name: result[name] for name in _REPORTED if name in result})
