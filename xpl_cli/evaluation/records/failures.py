"""Whose failure it was: the task's, the policy's or the infrastructure's (`failure` of a recorded episode)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl.safety import FAR_FIRST_ACTION, NON_FINITE
from xpl.vector import INFRASTRUCTURE

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl_cli.evaluation.records.records import Line

TASK, POLICY = "task", "policy"
POLICY_ERROR, POLICY_DIED = "policy_error", "policy_died"
"""`end_reason` where the policy's side raised or answered with nonsense, and where its process ended or hung."""
SUCCESS, MAX_STEPS = "success", "max_steps"
MOST_SPOILT = 0.1
"""Share of a run's episodes that the infrastructure may spoil; with more of them it is neither ranked nor bundled."""
_GUARDED = (FAR_FIRST_ACTION, NON_FINITE)
_NO_SUCCESS = (None, MAX_STEPS, POLICY_ERROR, POLICY_DIED, INFRASTRUCTURE, *_GUARDED)
_TOLD = (
    sdk.Obs.INSTRUCTION,
    "layout",
    "success",
    "score",
    "stages",
    "steps",
    "end_reason",
    "corrections",
    "safety",
    "digest",
)
_UNFINISHED = "the evaluation loop returned before the episode had ended"


def played(result: Mapping[str, Any]) -> Line:
    """Return what an environment's result says of an episode whose loop returned.

    Whoever has nothing to succeed at (success None) has no failure either.
    """
    told = _told(result)
    if told["end_reason"] == INFRASTRUCTURE:
        return {**told, **spoilt(str(result.get("error") or "the environment was lost"))}
    if told["success"] or told["success"] is None:
        return {**told, "failure": None}
    if told["end_reason"] is None:
        return failed(result, _UNFINISHED)
    if told["end_reason"] in _GUARDED:
        return {**told, "failure": POLICY, "error": f"a guard ended the episode: {told['end_reason']}"}
    return {**told, "failure": TASK}


def failed(result: Mapping[str, Any], reason: str) -> Line:
    """Return what is recorded where the policy broke an episode off: no success, and the score that it had come to."""
    return {**_told(result), "success": False, "failure": POLICY, "end_reason": POLICY_ERROR, "error": reason}


def died(result: Mapping[str, Any], reason: str) -> Line:
    """Return what is recorded where a process that runs the adapter's code ended or hung: a failure of the policy.

    It may be played again, because machines do kill processes; an episode of which no attempt survives has failed.
    """
    return {**failed(result, reason), "end_reason": POLICY_DIED}


def is_open(line: Mapping[str, Any]) -> bool:
    """Tell whether an attempt that ended so may be followed by another one."""
    return bool(line["failure"] == INFRASTRUCTURE or line["end_reason"] == POLICY_DIED)


def contradiction(line: Mapping[str, Any]) -> str | None:
    """Return in what the line of an episode contradicts itself about success, or None."""
    if line["success"] is False:
        return "did not succeed, but ended with success" if line["end_reason"] == SUCCESS else None
    if not line["success"]:
        return None
    stages = line.get("stages")
    against = {
        f"with a failure of the class {line['failure']}": line["failure"] is not None,
        f"but ended with {line['end_reason'] or 'nothing'}": line["end_reason"] in _NO_SUCCESS,
        "with a score of 0": line["score"] == 0,
        "but reached no stage": stages and not any(stages.values()),
    }
    found = next((said for said, holds in against.items() if holds), None)
    return None if found is None else f"succeeded, {found}"


def spoilt(reason: str) -> Line:
    """Return what is recorded where an attempt says nothing about the policy."""
    return {
        "success": None,
        "score": None,
        "failure": INFRASTRUCTURE,
        "end_reason": INFRASTRUCTURE,
        "error": reason,
    }


def _told(result: Mapping[str, Any]) -> Line:
    kept = {key: result[key] for key in _TOLD if key in result}
    return {"success": None, "score": None, "end_reason": None, **kept}
