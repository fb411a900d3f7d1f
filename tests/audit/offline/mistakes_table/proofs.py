"""The four proofs of one package: its contract, parity, demonstrations, and what it reaches in physics."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl_cli.audit.offline.demonstrations import action_errors
from xpl_cli.audit.rules.model import NotRun

if TYPE_CHECKING:
    from tests.audit.offline.mistakes_table.local import Judged

PARITY, FIT, FOLLOWED = "XPL260", "XPL270", "XPL271"


def demonstrations(planted: Judged, right: Judged, conventions: tuple[str, ...]) -> dict[str, Any]:
    """Return what demonstrations say of a package, and how far its answers are from the right one's.

    Args:
        planted: the package.
        right: the right one; the same object for the right one itself.
        conventions: any of them names the mistake.
    """
    started = time.monotonic()
    row: dict[str, Any] = {}
    try:
        row["apart"], row["own"] = _apart(planted, right)
    except NotRun as error:  # refused
        row["refused"] = str(error)
    try:
        fit = planted.fit
    except Exception as error:  # noqa: BLE001 - a row of the table, not its end
        return {**row, "outcome": "crash", "told": repr(error), "right": False, "convention": None}
    row["outcome"], row["seconds"] = str(fit.outcome), round(time.monotonic() - started, 1)
    result = fit.findings[0] if fit.findings else None
    cause = dict(dict(result.evidence or {})["cause"]) if result is not None else {}
    row["told"] = result.message if result is not None else fit.reason or json.dumps(fit.proof)
    row["words"], row["convention"] = cause.get("words"), cause.get("convention")
    row["share"], row["ties"] = cause.get("share"), cause.get("ties", [])
    row["right"] = bool(cause) and cause["convention"] in conventions
    row["followed"] = str(planted.followed.outcome)
    try:
        row["tried"] = _tried(planted)
    except NotRun as error:
        row["tried"] = {"not run": str(error)}
    return row


def _tried(planted: Judged) -> dict[str, Any]:
    """Return how every change fits that was tried."""
    outcome = planted.fact.outcome
    steps = planted.fact.errors
    still = planted.fact.baselines["holding the pose"]
    moved = planted.fact.metric.motion_share
    asked = range(len(planted.fact.answers))
    return {
        "error": float(steps.steps[steps.known].mean()),
        "still": float(still.steps[still.known].mean()),
        "complete": outcome.complete,
        "first": [[words, convention, round(share, 4)] for words, convention, share in outcome.first_round],
        "held": [
            [
                one.words,
                one.convention,
                round(one.margin.share, 4),
                round(one.margin.most, 4),
                moved(one.answers, asked),
            ]
            for one in outcome.final_round
        ],
    }


def _apart(planted: Judged, right: Judged) -> tuple[float, float]:
    """Return how far the answers are from the right ones, and how far these are from what was done, both as shares."""
    metric, own = right.fact.metric, right.fact.errors
    if planted is right:
        return 0.0, float(own.steps[own.known].mean())
    there, here = right.fact.answers, planted.fact.answers
    other = _AnswerDistance(metric, there).errors(dict(enumerate(here)), range(len(here)), planted.fact.refusals)
    return float(other.steps[other.known].mean()), float(own.steps[own.known].mean())


class _AnswerDistance(action_errors.ErrorMetric):
    """Measures against other answers than what was done, in the same spreads."""

    def __init__(self, metric: action_errors.ErrorMetric, answers: Any) -> None:
        super().__init__(metric.session)
        self.__dict__["_spread"] = metric._spread
        self._demonstrated = [
            list(answer)[: len(done)] for answer, done in zip(answers, metric._demonstrated, strict=True)
        ]


def audited(package: Path, python: str, seconds: float, codes: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return what an audit says: the codes that fail or warn, and the cause that parity names.

    Args:
        package: its folder.
        python: interpreter that runs the adapter.
        seconds: how long it may take.
        codes: rules; none for the contract, which is the static and the offline gate without the other proofs.
    """
    left_out = () if codes else (PARITY, FIT, FOLLOWED)  # proofs of their own, and parity's search takes minutes
    chosen = [word for code in codes for word in ("--select", code)]
    chosen += [word for code in left_out for word in ("--ignore", code)]
    gates = ["--gate", "offline"] if codes else ["--gate", "static", "--gate", "offline", "--keep-going"]
    options = ["--no-cache", "--json", "--time-limit", f"{int(seconds)}s", "--patience", "120"]
    command = [sys.executable, "-m", "xpl_cli", "audit", str(package), "--python", python, *gates, *chosen, *options]
    told = _json(command, seconds + 60)
    results = [one for target in told.get("targets", ()) for gate in target["gates"] for one in gate["results"]]
    bad = {one["code"]: one["outcome"] for one in results if one["outcome"] in ("fail", "warn", "error")}
    row: dict[str, Any] = {
        "rules": len(results),
        "codes": sorted(code for code in bad if code != PARITY),
        "failed": sorted(code for code, how in bad.items() if how == "fail" and code != PARITY),
        "not_run": sorted(one["code"] for one in results if one["outcome"] == "not_run"),
        "error": told.get("failure"),
    }
    for one in results:
        if one["code"] == PARITY:
            cause = next((dict(findings.get("evidence") or {}).get("cause") or {} for findings in one["findings"]), {})
            told_so = "; ".join(findings["message"] for findings in one["findings"]) or one["reason"]
            row["parity"] = {"outcome": one["outcome"], "told": told_so, **cause}
    return row


def success(package: Path, python: str, task: str, episodes: int, seconds: float) -> dict[str, Any]:
    """Return in how many of the first evaluation episodes of a task a package succeeds."""
    with tempfile.TemporaryDirectory() as place:
        run = ["--episodes", str(episodes), "--film", "0", "--out", f"{place}/run", "--workers", "1", "--json"]
        where = ["--env", "mujoco", "--task", task, "--setting", "clean", "--set", "seed=0"]
        command = [sys.executable, "-m", "xpl_cli", "eval", str(package), "--python", python, *where, *run]
        told = _json(command, seconds)
        played = [json.loads(line) for line in _lines(Path(place) / "run" / "records.jsonl")]
    ended = [one for one in played if "success" in one]
    return {
        "episodes": len(ended),
        "successes": sum(bool(one["success"]) for one in ended),
        "error": told.get("failure"),
    }


def record(package: Path, python: str, seconds: float) -> dict[str, Any]:
    """Have the authors' code answer scripted episodes, into the package."""
    return _json(
        [sys.executable, "-m", "xpl_cli", "model-io", "record", str(package), "--python", python, "--json"], seconds
    )


def _json(command: list[str], seconds: float) -> dict[str, Any]:
    """Return what a command prints; `failure` if it prints nothing. All that it started ends with it."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes, start_new_session=True) as process:  # type: ignore[call-overload]
        try:
            answer, notes = process.communicate(timeout=seconds)
            document: dict[str, Any] = json.loads(answer)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return {"failure": f"no answer within {seconds:.0f} s"}
        except ValueError:
            return {"failure": notes[-800:]}
    return document


def _lines(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.is_file() else []
