"""Check an environment's tasks: its expert solves every frozen evaluation seed, random actions solve none."""

from __future__ import annotations

import contextlib
import json
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import get_embodiment
from xpl_cli import env_play, environments
from xpl_cli.env_play import Scenario
from xpl_cli.errors import NotFoundError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from xpl_cli.progress import Progress

SCHEMA = "xpl.env-check/1"


@dataclass(frozen=True)
class Choice:
    """What to check; empty for everything that the environment offers.

    Attributes:
        tasks: names.
        embodiments: names.
        settings: names.
        episodes: seeds of each task and setting, from the first; None for all that are frozen.
        action_type: in which the expert plays.
    """

    tasks: Sequence[str] = ()
    embodiments: Sequence[str] = ()
    settings: Sequence[str] = ()
    episodes: int | None = None
    action_type: str = sdk.ACTION_TYPES[0]


def seeds(folder: Path, task: str, setting: str) -> list[int]:
    """Return the frozen evaluation seeds of a task in a setting.

    Raises:
        NotFoundError: there are none.
    """
    file = folder / "seeds" / f"{task}.json"
    if not file.is_file():
        raise NotFoundError(f"task {task} has no frozen seeds: {file} is missing")
    known = json.loads(file.read_text(encoding="utf-8"))
    if setting not in known:
        raise NotFoundError(f"{file} has no seeds for the setting {setting!r}; it has {', '.join(known)}")
    chosen: list[int] = known[setting]
    return chosen


def unsupported(entry: Mapping[str, Any], embodiment: str) -> str | None:
    """Return why a task (its entry in the manifest) is not offered with an embodiment; None if it is."""
    arms, count = entry.get("arms"), len(get_embodiment(embodiment).arms)
    if arms is not None and count not in arms:
        return f"for {' or '.join(map(str, arms))} arms"
    reason: str | None = entry.get("unsupported", {}).get(embodiment)
    return reason


def check(name: str, choice: Choice, say: Progress) -> dict[str, Any]:
    """Play the frozen seeds and return the report; nothing is replaced or written.

    Raises:
        NotFoundError: the environment, a task, an embodiment, a setting or its seeds do not exist.
    """
    folder = environments.find(name)
    facts = environments.manifest(folder)
    tasks = _chosen("task", choice.tasks, list(facts["tasks"]))
    embodiments = _chosen("embodiment", choice.embodiments, facts["embodiments"])
    settings = _chosen("setting", choice.settings, facts["settings"])
    rows = []
    for task, embodiment, setting in product(tasks, embodiments, settings):
        row: dict[str, Any] = {"task": task, "embodiment": embodiment, "setting": setting}
        reason = unsupported(facts["tasks"][task], embodiment)
        if reason is None:
            frozen = seeds(folder, task, setting)[: choice.episodes]
            say.detail(f"{task}, {embodiment}, {setting}: {len(frozen)} seeds")
            row |= _rates(Scenario(name, task, embodiment, setting, choice.action_type), frozen)
        rows.append({**row, "unsupported": reason})
    return {
        "schema": SCHEMA,
        "environment": facts["name"],
        sdk.Deploy.ACTION_TYPE: choice.action_type,
        "pairs": rows,
        "ok": all(map(_is_sound, rows)),
    }


def text(report: Mapping[str, Any]) -> str:
    """Return the report for people: a line for each task, embodiment and setting."""
    lines = list(_lines(report["pairs"]))
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]) - 1)]
    table = [
        "  ".join([*(cell.ljust(width) for cell, width in zip(line, widths, strict=False)), line[-1]]).rstrip()
        for line in lines
    ]
    played = [row for row in report["pairs"] if row["unsupported"] is None]
    sound = sum(map(_is_sound, played))
    return "\n".join([*table, "", f"{sound} of {len(played)} hold: the expert solves every seed, random actions none"])


def _rates(what: Scenario, frozen: Sequence[int]) -> dict[str, Any]:
    with contextlib.closing(env_play.make(what)) as env:
        solved = [env_play.play(env, env_play.expert(what), seed) for seed in frozen]
    with contextlib.closing(env_play.make(Scenario(what.environment, what.task, what.embodiment, what.setting))) as env:
        guessed = [env_play.play(env, env_play.at_random(what, seed), seed) for seed in frozen]
    return {"episodes": len(frozen), "expert": _summary(solved), "random": _summary(guessed)}


def _summary(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    count = max(1, len(results))
    solved = [result for result in results if result["success"]]
    return {
        "solved": len(solved),
        "mean_score": sum(result["score"] for result in results) / count,
        "mean_steps": sum(result["steps"] for result in results) / count,
        "corrected_episodes": sum(bool(result["corrections"]) for result in results),
        "solved_seeds": [result[sdk.Deploy.SEED] for result in solved],
        "failed_seeds": [result[sdk.Deploy.SEED] for result in results if not result["success"]],
    }


def _is_sound(row: Mapping[str, Any]) -> bool:
    if row["unsupported"] is not None:
        return True
    return bool(row["expert"]["solved"] == row["episodes"] and row["random"]["solved"] == 0)


def _lines(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    yield ("task", "embodiment", "setting", "expert", "random", "steps", "")
    for row in rows:
        place = (row["task"], row["embodiment"], row["setting"])
        if row["unsupported"] is not None:
            yield (*place, "-", "-", "-", f"not offered: {row['unsupported']}")
            continue
        expert, guess = row["expert"], row["random"]
        rates = (f"{part['solved']}/{row['episodes']}" for part in (expert, guess))
        faults = [f"expert fails on {_some(expert['failed_seeds'])}"] if expert["failed_seeds"] else []
        faults += [f"random solves {_some(guess['solved_seeds'])}"] if guess["solved"] else []
        yield (*place, *rates, f"{expert['mean_steps']:.0f}", "; ".join(faults))


def _some(numbers: Sequence[int]) -> str:
    shown = ", ".join(map(str, numbers[:5]))
    return shown if len(numbers) <= 5 else f"{shown} and {len(numbers) - 5} more"


def _chosen(what: str, wanted: Sequence[str], offered: Sequence[str]) -> Sequence[str]:
    for name in wanted:
        if name not in offered:
            raise NotFoundError(f"there is no {what} {name!r}; there are: {', '.join(offered)}")
    return wanted or offered
