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
POLICY_ERROR = "policy_error"
_GUARDED = (FAR_FIRST_ACTION, NON_FINITE)
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
