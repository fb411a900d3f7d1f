"""Aggregate result files of other benchmarks: for each policy by dimension, by robot or setting, and overall.

RoboDojo's rule (`counts` in `envs/robodojo/env.yml`): a task counts for a seed once all its episodes exist, half of
each form for tasks with a randomized form; a dimension is the mean of its tasks, a policy the mean of its dimensions,
so that none with many tasks outweighs the others; mean and standard deviation are over the seeds. Tasks that the rule
does not know count with all of their episodes, as a dimension of their own.
"""

from __future__ import annotations

import statistics
from collections import defaultdict
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Final

from xpl_cli.basics.content import content_folder
from xpl_cli.evaluation.leaderboard.result_trees import ROBODOJO
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from xpl_cli.evaluation.leaderboard.result_trees import BenchmarkResult

OTHER: Final = "Other"


@dataclass(frozen=True)
class MeanScore:
    """A mean over seeds.

    Attributes:
        success: rate, 0 to 1.
        score: 0 to 1; None where the results have none.
        success_spread, score_spread: standard deviation over the seeds (of the population); 0 for one seed.
    """

    success: float
    score: float | None
    success_spread: float = 0.0
    score_spread: float | None = None


@dataclass
class PolicyScores:
    """The scores of one policy.

    Attributes:
        policy: its name.
        overall: None if nothing counts.
        dimensions: by dimension.
        variants: by robot, or by setting.
        halves: of the tasks with a randomized form: `standard` and `random`.
        tasks: by task.
        counted, expected: tasks and seeds that count, and all of them.
    """

    policy: str
    overall: MeanScore | None = None
    dimensions: dict[str, MeanScore] = field(default_factory=dict)
    variants: dict[str, MeanScore] = field(default_factory=dict)
    halves: dict[str, MeanScore] = field(default_factory=dict)
    tasks: dict[str, MeanScore] = field(default_factory=dict)
    counted: int = 0
    expected: int = 0


@dataclass(frozen=True)
class _Cell:
    """A task of a policy in one variant and seed."""

    dimension: str
    task: str
    variant: str
    seed: int
    success: float
    score: float | None


@dataclass(frozen=True)
class Protocol:
    """How RoboDojo counts.

    Attributes:
        dimensions: tasks by dimension, with the names and in the order of its tables.
        randomized: the dimension whose tasks have another form.
        random_suffix: of the other form's name.
        seeds: of its evaluation.
        episodes, halves: of a task; of each form of one that has two.
    """

    dimensions: Mapping[str, list[str]]
    randomized: str
    random_suffix: str
    seeds: Sequence[int]
    episodes: int
    halves: int


@cache
def protocol() -> Protocol:
    """Return how RoboDojo counts, from its environment package."""
    facts = environments.manifest(content_folder("envs") / ROBODOJO)
    counts, suffix = facts.data["counts"], facts.data["hand_over"]["randomized"]
    tasks = {task: entry.dimension for task, entry in facts.tasks.items()}
    dimensions = {
        title: [task for task, about in tasks.items() if about == name and not task.endswith(suffix)]
        for name, title in counts["dimensions"].items()
    }
    randomized = next(counts["dimensions"][about] for task, about in tasks.items() if task.endswith(suffix))
    return Protocol(dimensions, randomized, suffix, counts["seeds"], counts["episodes"], counts["halves"])


def dimension_of(task: str) -> str:
    """Return the dimension that a task is about."""
    return next((name for name, tasks in protocol().dimensions.items() if task in tasks), OTHER)


def score_policies(results: Sequence[BenchmarkResult], *, partial: bool = False) -> list[PolicyScores]:
    """Return the scores of each policy, by name.

    Args:
        results: the latest of each task, policy, robot and seed.
        partial: count also tasks of RoboDojo that lack episodes.
    """
    by_policy: dict[str, list[BenchmarkResult]] = defaultdict(list)
    for result in results:
        by_policy[result.policy].append(result)
    return [_score_policy(name, policy_results, partial=partial) for name, policy_results in sorted(by_policy.items())]


def _score_policy(policy: str, results: Sequence[BenchmarkResult], *, partial: bool) -> PolicyScores:
    cells, halves = _cells(results, partial=partial)
    rules = protocol()
    is_known = any(dimension_of(_base(result)) != OTHER for result in results)
    cases = {(_base(result), result.variant, result.seed) for result in results}
    whole = sum(map(len, rules.dimensions.values())) * len(rules.seeds)
    scores = PolicyScores(policy, counted=len(cells), expected=whole if is_known else len(cases))
    scores.dimensions = _scores_by_group(cells, lambda cell: cell.dimension)
    scores.variants = _scores_by_group(cells, lambda cell: cell.variant)
    scores.tasks = _scores_by_group(cells, lambda cell: cell.task)
    scores.halves = {name: figure for name, part in halves.items() if (figure := _over_seeds(part)) is not None}
    scores.overall = _overall(cells)
    return scores


def _cells(results: Sequence[BenchmarkResult], *, partial: bool) -> tuple[list[_Cell], dict[str, list[_Cell]]]:
    """Return the cells that count, and the halves of those with a randomized form."""
    rules = protocol()
    suffix, half, full = rules.random_suffix, rules.halves, rules.episodes
    cells: list[_Cell] = []
    halves: dict[str, list[_Cell]] = {"standard": [], "random": []}
    by_case = {(result.task, result.variant, result.seed): result for result in results}
    for (task, variant, seed), result in sorted(by_case.items()):
        base = _base(result)
        dimension = dimension_of(base)
        if dimension == OTHER or result.benchmark != ROBODOJO:
            cells.append(_Cell(OTHER, task, variant, seed, result.success, result.score))
        elif dimension == rules.randomized:
            name = "standard" if task == base else "random"
            part = _first(result, half, partial=partial)
            if part is not None:
                halves[name].append(_Cell(dimension, base, variant, seed, *part))
            other = by_case.get((f"{base}{suffix}", variant, seed)) if task == base else None
            rest = None if other is None else _first(other, half, partial=partial)
            if part is not None and rest is not None:
                success, score = ((one + two) / 2 for one, two in zip(part, rest, strict=True))
                cells.append(_Cell(dimension, base, variant, seed, success, score))
            elif part is not None and partial and task == base:
                cells.append(_Cell(dimension, base, variant, seed, *part))
        else:
            part = _first(result, full, partial=partial)
            if part is not None:
                cells.append(_Cell(dimension, base, variant, seed, *part))
    return cells, halves


def _base(result: BenchmarkResult) -> str:
    """Return the task that a randomized form is of."""
    base = result.task.removesuffix(protocol().random_suffix)
    return base if dimension_of(base) == protocol().randomized else result.task


def _first(result: BenchmarkResult, count: int, *, partial: bool) -> tuple[float, float] | None:
    """Return success and score of the first episodes; None where there are not so many."""
    episodes = result.episodes
    if episodes is None or len(episodes) < count:
        if not partial:
            return None
        return result.success, result.success if result.score is None else result.score
    chosen = episodes[:count]
    return sum(success for success, _ in chosen) / count, sum(score for _, score in chosen) / count


def _scores_by_group(cells: Iterable[_Cell], name: Callable[[_Cell], str]) -> dict[str, MeanScore]:
    """Return a figure for each group of cells."""
    groups: dict[str, list[_Cell]] = defaultdict(list)
    for cell in cells:
        groups[name(cell)].append(cell)
    order = [*protocol().dimensions, OTHER]
    names = sorted(groups, key=lambda each: (order.index(each) if each in order else len(order), each))
    return {each: figure for each in names if (figure := _over_seeds(groups[each])) is not None}


def _over_seeds(cells: Sequence[_Cell]) -> MeanScore | None:
    """Return mean and spread over the seeds of the means of their cells."""
    return _mean_score(_by_seed(cells).values())


def _by_seed(cells: Iterable[_Cell]) -> Mapping[int, tuple[float, float | None]]:
    seeds: dict[int, list[_Cell]] = defaultdict(list)
    for cell in cells:
        seeds[cell.seed].append(cell)
    return {seed: _mean([(cell.success, cell.score) for cell in seed_cells]) for seed, seed_cells in seeds.items()}


def _overall(cells: Sequence[_Cell]) -> MeanScore | None:
    """Return mean and spread over the seeds of the means of their dimensions."""
    dimensions: dict[str, list[_Cell]] = defaultdict(list)
    for cell in cells:
        dimensions[cell.dimension].append(cell)
    means: dict[int, list[tuple[float, float | None]]] = defaultdict(list)
    for group in dimensions.values():
        for seed, mean in _by_seed(group).items():
            means[seed].append(mean)
    return _mean_score([_mean(group) for group in means.values()])


def _mean(pairs: Sequence[tuple[float, float | None]]) -> tuple[float, float | None]:
    scores = [score for _, score in pairs if score is not None]
    success = statistics.fmean(success for success, _ in pairs)
    return success, statistics.fmean(scores) if len(scores) == len(pairs) else None


def _mean_score(means: Iterable[tuple[float, float | None]]) -> MeanScore | None:
    values = list(means)
    if not values:
        return None
    success, score = _mean(values)
    scores = [value for _, value in values if value is not None]
    spread = None if score is None else statistics.pstdev(scores)
    return MeanScore(success, score, statistics.pstdev([value for value, _ in values]), spread)
