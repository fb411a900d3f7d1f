"""What environment packages offer."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.basics.errors import NotFoundError
from xpl_cli.environments import check
from xpl_cli.environments.rollout import unsupported
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from xpl.manifest import EnvManifest

_SUCCESS = "success_means"  # of env.yml, or of a task there: a sentence


def offers(name: str | None = None) -> list[dict[str, Any]]:
    """Return the offer of one environment, or of each: tasks with the embodiments that they support.

    Raises:
        NotFoundError: there is no environment of this name.
    """
    if name is not None:
        return [_offer(environments.find(name))]
    return [_offer(environments.find(each)) for each in environments.names()]


def text(offers: Sequence[Mapping[str, Any]]) -> str:
    """Return the list for people."""
    return "\n\n".join("\n".join(_lines(offer)) for offer in offers)


def markdown(offers: Sequence[Mapping[str, Any]]) -> str:
    """Return the tasks as Markdown tables: capability, number of arms, scoring, length and instruction."""
    return "\n\n".join("\n".join(_rows(offer["tasks"])) for offer in offers)


def _rows(tasks: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    yield "| task | asks for | arms | stages, with their share of the score | steps | instruction |"
    yield "| --- | --- | --- | --- | --- | --- |"
    for task, entry in tasks.items():
        stages = ", ".join(f"{name} {weight:g}" for name, weight in entry["stages"].items())
        arms = " or ".join(map(str, entry["arms"] or ["any"]))
        cells = (f"`{task}`", entry["dimension"] or "", arms, stages, entry["max_steps"], entry[sdk.Obs.INSTRUCTION])
        yield f"| {' | '.join(map(str, cells))} |"


def _offer(folder: Path) -> dict[str, Any]:
    facts = environments.manifest(folder)
    tasks = {
        task: {
            sdk.Obs.INSTRUCTION: entry.instruction,
            "dimension": entry.dimension,
            "arms": list(entry.arms) or None,
            "max_steps": entry.max_steps,
            "seeds": _seeds(folder, task, facts),
            "success": entry.success_means or facts.success_means,
            "stages": dict(entry.stages),
            "embodiments": [robot for robot in facts.embodiments if unsupported(entry, robot) is None],
            "unsupported": {
                robot: reason for robot in facts.embodiments if (reason := unsupported(entry, robot)) is not None
            },
        }
        for task, entry in facts.tasks.items()
    }
    return {
        "name": facts.name,
        "title": facts.title,
        "action_types": list(facts.action_types),
        "settings": list(facts.settings),
        "embodiments": list(facts.embodiments),
        "cameras": list(facts.cameras),
        "splits": dict(facts.splits),
        "tasks": tasks,
    }


def _seeds(folder: Path, task: str, facts: EnvManifest) -> dict[str, list[int]]:
    """Return how many frozen evaluation seeds a task has in each setting, and the first of them; nothing for none."""
    counts = {}
    for kind in facts.settings:
        with contextlib.suppress(NotFoundError):
            seeds = check.seeds(folder, task, kind, facts)
            counts[kind] = [len(seeds), seeds[0]]
    return counts


def _lines(offer: Mapping[str, Any]) -> list[str]:
    width = max(map(len, offer["tasks"]))
    lines = [
        f"{offer['name']}: {offer['title']}",
        f"  embodiments: {', '.join(offer['embodiments'])}",
        f"  control: {', '.join(offer['action_types'])}; settings: {', '.join(offer['settings'])}",
        f"  cameras: {', '.join(offer['cameras']) or 'none'}",
        *_splits(offer["splits"]),
        *_common(list(offer["tasks"].values())),
    ]
    for task, entry in offer["tasks"].items():
        description = f"{entry[sdk.Obs.INSTRUCTION]}{_robot_note(entry['embodiments'], entry['unsupported'])}"
        lines.append(f"  {task.ljust(width)}  {entry['max_steps']:>4} steps  {description}")
    return lines


def _robot_note(offered: Sequence[str], missing: Mapping[str, str]) -> str:
    """Return which robots a task is for, where that is not all of them."""
    if not missing:
        return ""
    if not offered:
        return f" (not offered: {next(iter(missing.values()))})"
    return f" (only {', '.join(offered)})" if len(offered) < len(missing) else f" (not {', '.join(missing)})"


def _splits(splits: Mapping[str, Sequence[str]]) -> Iterator[str]:
    if splits:
        yield f"  splits: {', '.join(f'{name} ({len(tasks)})' for name, tasks in splits.items())}"


def _common(tasks: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield what is the same for every task: the seeds, and what success is."""
    first = tasks[0]
    if first["seeds"] and all(entry["seeds"] == first["seeds"] for entry in tasks):
        counts = (f"{kind} {count} from {start}" for kind, (count, start) in first["seeds"].items())
        yield f"  evaluation seeds of each task: {', '.join(counts)}"
    if first["success"] and all(entry["success"] == first["success"] for entry in tasks):
        yield f"  success: {first['success']}"
