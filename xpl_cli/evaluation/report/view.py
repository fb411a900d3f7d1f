"""What the page says, in the order in which it says it: texts and charts, made from a summary and the run."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli import __version__
from xpl_cli.evaluation.records import manner, stand_ins
from xpl_cli.evaluation.report import figures, latency, provenance
from xpl_cli.evaluation.report.phrases import between, duration, many, milliseconds, points
from xpl_cli.evaluation.statistics import wording

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from xpl_cli.evaluation.records.records import Run

    Row = Mapping[str, Any]

_COLOURS = 5  # of settings, in page.css
_MOST_REASONS = 8


def view(run: Run, summary: Mapping[str, Any], media_said: str) -> dict[str, Any]:
    """Return what the template of the page asks for.

    Args:
        run: the run.
        summary: of it, `xpl.summary/1`.
        media_said: a sentence on films and curves.
    """
    overall = summary["overall"]
    complete = not overall["unplayed"]
    kinds = _kinds(row["setting"] for row in summary["cells"])
    return {
        "title": f"{summary['policy']} in {summary['environment']}",
        "policy": summary["policy"],
        "environment": summary["environment"],
        "complete": complete,
        "state": "complete" if complete else f"{overall['played']} of {overall['planned']} episodes",
        "about": _about(summary, manner.of(run.plan).sentence),
        **_headline(summary),
        "facts": _facts(summary),
        "confidence": wording.percent(summary["confidence"]),
        "settings": [{"name": name, "kind": kind} for name, kind in kinds.items()],
        "tasks": _tasks(summary, kinds),
        "groups": _groups(summary, kinds),
        **_contrasts(summary, kinds),
        "table": _table(summary, kinds),
        "notes": [*summary["notes"], *summary["course"]["notes"]],
        "failures": _failures(run, overall),
        "corrections": _corrections(run, overall),
        "latency": latency.view(summary["course"]["inference"]),
        "media_said": media_said,
        "versions": provenance.view(run, summary),
        "footer": f"Made by xpl {__version__} from the record of this run.",
    }


def _kinds(settings: Iterable[str]) -> dict[str, str]:
    """Return the colour class of each setting."""
    return {name: f"s{place % _COLOURS}" for place, name in enumerate(dict.fromkeys(settings))}


def _about(summary: Mapping[str, Any], unusual: str) -> str:
    tasks, settings = (len(summary[name]) for name in ("tasks", "settings"))
    robot = f"{summary['embodiment']}, {summary[sdk.Deploy.ACTION_TYPE]} control"
    planned = f"{many(summary['overall']['planned'], 'episode')} planned"
    unreal = stand_ins.sentence(summary["environment"], (row["setting"] for row in summary["settings"]))
    told = f", {unusual}" if unusual else ""
    said = f"{robot}. {many(tasks, 'task')} in {many(settings, 'setting')}, {planned}{told}."
    return said if unreal is None else f"{unreal} {said}"


def _headline(summary: Mapping[str, Any]) -> dict[str, Any]:
    overall = summary["overall"]
    rate, interval = overall["success_rate"], overall["success_interval"]
    if rate is None:
        said = "No episode has a success to speak of yet."
        return {
            "rate": wording.NOTHING,
            "rate_unit": "",
            "rate_said": said,
            "rate_figure": figures.strip(None, None, "s0", said),
        }
    low, high = interval
    said = (
        f"{overall['successes']} of {overall['judged']} episodes succeeded. "
        f"The {wording.percent(summary['confidence'])} interval goes from {100 * low:.1f} to {100 * high:.1f} %."
    )
    return {
        "rate": f"{100 * rate:.1f}".removesuffix(".0"),
        "rate_unit": "%",
        "rate_said": said,
        "rate_figure": figures.strip(rate, interval, "s0", f"{100 * rate:.1f} % {said}"),
    }


def _facts(summary: Mapping[str, Any]) -> list[dict[str, str]]:
    overall, course = summary["overall"], summary["course"]
    failures = overall["failures"]
    score, inference = overall["mean_score"], course["inference"]
    facts = [
        (
            "Mean score",
            wording.NOTHING if score is None else f"{score:.2f}",
            between(overall["score_interval"], 2),
        ),
        ("Task not achieved", str(failures["task"]), "played to the end"),
        ("Failed by the policy", str(failures["policy"]), "error or stopped; no success"),
        ("Spoilt by infrastructure", str(failures["infrastructure"]), _spoilt(overall, course)),
        (
            "Action request",
            milliseconds(inference.get("p50")),
            f"median; 95 % within {milliseconds(inference.get('p95'))}",
        ),
        (
            "Played for",
            duration(course["wall_seconds"]),
            f"all episodes together, {many(course['attempts'], 'attempt')}",
        ),
    ]
    return [{"name": name, "value": value, "note": note} for name, value, note in facts]


def _spoilt(overall: Row, course: Mapping[str, Any]) -> str:
    bounds = overall["if_spoilt"]
    retried = f"{course['retried']} played again" if course["retried"] else ""
    if bounds is None:
        return retried or "nothing left out"
    return f"left out; {100 * bounds[0]:.1f} to {100 * bounds[1]:.1f} % if counted"


def _tasks(summary: Mapping[str, Any], kinds: Mapping[str, str]) -> list[dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for row in summary["cells"]:
        entry = found.setdefault(row["task"], {"name": row["task"], "dimension": row["dimension"], "bars": []})
        label = f"{row['task']}, {row['setting']}: {wording.rate(row)}"
        figure = figures.bar(row["success_rate"], row["success_interval"], kinds[row["setting"]], label)
        entry["bars"].append({"figure": figure, "text": wording.rate(row)})
    return list(found.values())


def _groups(summary: Mapping[str, Any], kinds: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return the rows by setting and by dimension, where there are several."""
    groups = []
    for title, rows, name in (
        ("By setting", summary["settings"], "setting"),
        ("By dimension", summary["dimensions"], "dimension"),
    ):
        if len(rows) > 1:
            shown = [
                {
                    "name": row[name],
                    "text": wording.rate(row),
                    "figure": figures.strip(
                        row["success_rate"],
                        row["success_interval"],
                        kinds.get(row[name], "s0"),
                        f"{row[name]}: {wording.rate(row)}",
                    ),
                }
                for row in rows
            ]
            groups.append({"title": title, "rows": shown})
    return groups


def _contrasts(summary: Mapping[str, Any], kinds: Mapping[str, str]) -> dict[str, Any]:
    rows = [row for row in summary["contrasts"] if row["difference"] is not None]
    if not rows:
        return {"contrasts": [], "contrast_title": "", "contrast_said": ""}
    first = rows[0]["settings"][0]
    others = list(dict.fromkeys(row["settings"][1] for row in rows))
    named = f" in {others[0]}" if len(others) == 1 else ""
    shared = {bool(row["pairs"]) for row in rows}
    how = "on seeds of their own where the two share none"
    if len(shared) == 1:
        how = "on the same seeds" if shared.pop() else "on seeds of their own"
    shown = []
    for row in rows:
        task, other = row["task"] or "all tasks", row["settings"][1]
        name = task if named else f"{task}, {other}"
        low, high = map(points, row["interval"])
        text = f"{points(row['difference'])} ({low} to {high})"
        figure = figures.difference(row["difference"], row["interval"], kinds[other], f"{name}: {text}")
        shown.append({"name": name, "figure": figure, "text": text})
    return {
        "contrasts": shown,
        "contrast_title": f"{first.capitalize()} against {others[0] if named else 'the others'}",
        "contrast_said": (
            f"Success{named} less success in {first}, in points, {how}. An interval that holds 0 shows no difference."
        ),
    }


def _table(summary: Mapping[str, Any], kinds: Mapping[str, str]) -> dict[str, Any]:
    header = [
        ("Task", ""),
        ("Setting", ""),
        ("Episodes", "number"),
        ("Success", "number"),
        ("", "mini"),
        ("Interval", "number"),
        ("Score", "number"),
        ("Interval", "number"),
        ("Policy", "number"),
        ("Spoilt", "number"),
        ("Steps", "number"),
    ]
    return {
        "header": [{"name": name, "kind": kind} for name, kind in header],
        "rows": [
            {
                "total": row["task"] is None,
                "cells": [
                    {"value": value, "kind": kind}
                    for value, (_, kind) in zip(_cells(row, kinds.get(row["setting"], "s0")), header, strict=True)
                ],
            }
            for row in wording.shown(summary)
        ],
    }


def _cells(row: Row, kind: str) -> Sequence[Any]:
    rate, score, failures = row["success_rate"], row["mean_score"], row["failures"]
    episodes = str(row["judged"]) if not row["unplayed"] else f"{row['judged']} of {row['planned']}"
    return (
        row["task"] or "all tasks",
        row["setting"] or "all",
        episodes,
        wording.NOTHING if rate is None else f"{100 * rate:.1f} %",
        figures.strip(rate, row["success_interval"], kind, wording.rate(row)),
        between(row["success_interval"], 1, 100),
        wording.NOTHING if score is None else f"{score:.2f}",
        between(row["score_interval"], 2),
        str(failures["policy"]),
        str(failures["infrastructure"]),
        wording.NOTHING if row["mean_steps"] is None else f"{row['mean_steps']:.0f}",
    )


def _failures(run: Run, overall: Row) -> dict[str, Any]:
    failures = overall["failures"]
    counts = {
        "success": overall["successes"],
        "task": failures["task"],
        "policy": failures["policy"],
        "infrastructure": failures["infrastructure"],
        "not-judged": overall["played"] - overall["judged"] - failures["infrastructure"],
        "unplayed": overall["unplayed"],
    }
    names = {
        "success": "succeeded",
        "task": "task not achieved",
        "policy": "failed by the policy",
        "infrastructure": "spoilt by the infrastructure",
        "not-judged": "nothing to succeed at",
        "unplayed": "not played yet",
    }
    reasons = Counter(
        episode.error or episode.end_reason or "no reason given"
        for episode in run.finals.values()
        if episode.failure is not None
    )
    return {
        "said": (
            "Of all episodes that were planned. A policy that fails or is stopped has not succeeded; what the "
            "infrastructure spoilt is played again within a bound, and then counts as failed."
        ),
        "figure": figures.shares(counts, ", ".join(f"{names[kind]} {count}" for kind, count in counts.items())),
        "parts": [{"kind": kind, "name": names[kind], "count": count} for kind, count in counts.items() if count],
        "reasons": [{"text": text, "count": count} for text, count in reasons.most_common(_MOST_REASONS)],
    }


def _corrections(run: Run, overall: Row) -> list[dict[str, str]]:
    touched = Counter(kind for episode in run.finals.values() for kind in episode.corrections or {})
    return [
        {
            "name": kind.replace("_", " "),
            "text": f"{many(steps, 'step')} of {many(touched[kind], 'episode')}",
        }
        for kind, steps in sorted(overall["corrections"].items(), key=lambda item: -item[1])
    ]
