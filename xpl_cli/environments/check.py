"""Check an environment's tasks: its expert solves every frozen evaluation seed, random actions solve none."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import json_text
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.basics.parallel import map_in_processes
from xpl_cli.environments import rollout
from xpl_cli.environments.rollout import Scenario, unsupported
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from xpl.contract import Result
    from xpl.manifest import EnvManifest
    from xpl_cli.basics.progress import Progress

    _Job = tuple[Scenario, Sequence[int]]
    _Played = tuple[list[Result], list[Result]]
    _Row = dict[str, Any]
    """One pair in the report: `unsupported`, or `episodes` and the figures of `expert` and `random`."""

__all__ = ["SEEDS", "CheckSelection", "check", "seeds", "text", "unsupported"]

SEEDS = "seeds"
"""Folder of an environment package with the frozen evaluation seeds of its tasks."""

_BATCH = 10  # episodes of one process at a time


@dataclass(frozen=True)
class CheckSelection:
    """What to check; empty for everything that the environment offers.

    Attributes:
        tasks: names.
        embodiments: names.
        settings: names.
        episodes: seeds of each task and setting, from the first; None for all that are frozen.
        action_type: of the expert; the environment's first by default.
    """

    tasks: Sequence[str] = ()
    embodiments: Sequence[str] = ()
    settings: Sequence[str] = ()
    episodes: int | None = None
    action_type: str | None = None


def seeds(folder: Path, task: str, setting: str, facts: EnvManifest | None = None) -> list[int]:
    """Return the frozen evaluation seeds of a task in a setting: of its file, or those that env.yml gives all tasks.

    Args:
        folder: the environment's.
        task: of it.
        setting: of it.
        facts: its manifest, where that has been read already.

    Raises:
        NotFoundError: there are none.
    """
    common = (environments.manifest(folder) if facts is None else facts).evaluation_seeds
    if common is not None:
        return list(range(common.first, common.first + common.count))
    file = folder / SEEDS / f"{task}.json"
    if not file.is_file():
        raise NotFoundError(f"task {task} has no frozen seeds: {file} is missing")
    seeds_by_setting = json_text.parse(file.read_bytes())
    if setting not in seeds_by_setting:
        raise NotFoundError(f"{file} has no seeds for the setting {setting!r}; it has {', '.join(seeds_by_setting)}")
    chosen: list[int] = seeds_by_setting[setting]
    return chosen


def has_seeds(folder: Path) -> bool:
    """Return whether an environment has frozen evaluation seeds."""
    return (folder / SEEDS).is_dir() or environments.manifest(folder).evaluation_seeds is not None


def check(name: str, choice: CheckSelection, say: Progress, workers: int | None = 1) -> dict[str, Any]:
    """Run the frozen seeds and return the report; nothing is replaced or written.

    Args:
        name: the environment.
        choice: selected parts.
        say: progress.
        workers: processes; 1 for this one, None for one per core. The report does not depend on it.

    Raises:
        NotFoundError: the environment, a task, an embodiment, a setting or its seeds do not exist.
        UserError: a process died.
    """
    environments.require_simulation(name)
    folder = environments.find(name)
    facts = environments.manifest(folder)
    tasks = _choose_names("task", rollout.expand_splits(facts, choice.tasks), facts.tasks)
    robots = _choose_names("embodiment", choice.embodiments, facts.embodiments)
    settings = _choose_names("setting", choice.settings, facts.settings)
    control = rollout.choose_name("kind of control", choice.action_type, facts.action_types)
    rows: list[_Row] = []
    for task, robot, setting in product(tasks, robots, settings):
        reason = rollout.unsupported(facts.tasks[task], robot)
        rows.append({"task": task, "embodiment": robot, "setting": setting, "unsupported": reason})
    supported = [row for row in rows if row["unsupported"] is None]
    jobs = [
        (Scenario(name, row["task"], row["embodiment"], row["setting"], control), batch)
        for row in supported
        for batch in _batches(seeds(folder, row["task"], row["setting"])[: choice.episodes])
    ]
    results: dict[Scenario, list[_Played]] = {}
    count = 2 * sum(len(batch) for _, batch in jobs)
    say.step(f"{name}: {count} episodes, half of them of the expert; --task and --episodes choose fewer")
    for index, ((scenario, _), answer) in enumerate(zip(jobs, _results(jobs, workers), strict=True), start=1):
        say.detail(f"{scenario.task}, {scenario.embodiment}, {scenario.setting} ({index} of {len(jobs)})")
        if scenario not in results and all(other.task != scenario.task for other in results):
            say.step(f"{scenario.task} ({index - 1} of {len(jobs)} parts are done)")
        results.setdefault(scenario, []).append(answer)
    for row, batches in zip(supported, results.values(), strict=True):
        row.update(_rates(batches))
    return {
        "environment": facts.name,
        sdk.Deploy.ACTION_TYPE: control,
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
    supported = [row for row in report["pairs"] if row["unsupported"] is None]
    sound = sum(map(_is_sound, supported))
    return "\n".join(
        [*table, "", f"{sound} of {len(supported)} pass: the expert solves every seed, random actions none"]
    )


def _batches(frozen: Sequence[int]) -> list[Sequence[int]]:
    """Return the seeds in parts that are worth a process."""
    return [frozen[start : start + _BATCH] for start in range(0, len(frozen), _BATCH)]


def _results(jobs: Sequence[_Job], workers: int | None) -> Iterator[_Played]:
    """Yield the results of the jobs, in their order."""
    if workers == 1 or len(jobs) <= 1:
        yield from map(_play, jobs)
        return
    for (scenario, _), answer in zip(jobs, map_in_processes(_play, jobs, workers), strict=True):
        if answer is None:
            raise UserError(
                f"the process that ran {scenario.task} with {scenario.embodiment} ({scenario.setting}) died",
                hint="Run it alone to see why: --task, --embodiment, --setting, --workers 1.",
                code=ExitCode.NOT_RUN,
            )
        yield answer


def _play(job: _Job) -> _Played:
    """Return the results of the expert, and of random actions, which are joint angles where those are offered."""
    scenario, numbers = job
    offered = environments.manifest(environments.find(scenario.environment)).action_types
    with contextlib.closing(rollout.make(scenario)) as env:
        solved = [rollout.run_episode(env, rollout.expert(scenario), seed) for seed in numbers]
    guess = replace(scenario, action_type=rollout.random_control(offered))
    with contextlib.closing(rollout.make(guess)) as env:
        guessed = [rollout.run_episode(env, rollout.random_actions(guess, seed), seed) for seed in numbers]
    return solved, guessed


def _rates(batches: Sequence[_Played]) -> _Row:
    solved, guessed = ([result for part in parts for result in part] for parts in zip(*batches, strict=True))
    return {"episodes": len(solved), "expert": _summary(solved), "random": _summary(guessed)}


def _summary(results: Sequence[Result]) -> dict[str, object]:
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


def _is_sound(row: _Row) -> bool:
    if row["unsupported"] is not None:
        return True
    return bool(row["expert"]["solved"] == row["episodes"] and row["random"]["solved"] == 0)


def _lines(rows: Sequence[_Row]) -> Iterator[tuple[str, ...]]:
    yield ("task", "embodiment", "setting", "expert", "steps", "random", "score", "")
    for row in rows:
        labels = (row["task"], row["embodiment"], row["setting"])
        if row["unsupported"] is not None:
            yield (*labels, "-", "-", "-", "-", f"not offered: {row['unsupported']}")
            continue
        expert, guess = row["expert"], row["random"]
        solved, guessed = (f"{part['solved']}/{row['episodes']}" for part in (expert, guess))
        faults = [f"expert fails on {_list_some(expert['failed_seeds'])}"] if expert["failed_seeds"] else []
        faults += [f"random solves {_list_some(guess['solved_seeds'])}"] if guess["solved"] else []
        figures = (solved, f"{expert['mean_steps']:.0f}", guessed, f"{guess['mean_score']:.2f}")
        yield (*labels, *figures, "; ".join(faults))


def _list_some(numbers: Sequence[int]) -> str:
    listing = ", ".join(map(str, numbers[:5]))
    return listing if len(numbers) <= 5 else f"{listing} and {len(numbers) - 5} more"


def _choose_names(what: str, requested: Sequence[str], offered: Iterable[str]) -> Sequence[str]:
    """Return all names that are wanted, each once, or all that are offered."""
    names = list(offered)
    return [rollout.choose_name(what, name, names) for name in dict.fromkeys(requested)] or names
