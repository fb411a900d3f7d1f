"""The result of a hand-over: `xpl.env-hand-over/1`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from xpl_cli.evaluation.hand_over.results import LayoutResult


@dataclass(frozen=True)
class HandOverAnswer:
    """What was run, by which command, and the result.

    Attributes:
        environment, bench_name, policy, task, embodiment, action_type: of the run.
        run_id: name of the run.
        rehearsal: whether it was a rehearsal, which gives no numbers.
        command: command line of the launcher.
        seconds: duration.
        result: the file that the benchmark wrote.
        episodes, successes, mean_score: None if the benchmark reports a rate only.
        success_rate: None also without episodes.
    """

    environment: str
    bench_name: str
    policy: str
    task: str
    embodiment: str
    action_type: str
    run_id: str
    rehearsal: bool
    command: Sequence[str]
    seconds: float
    result: str | None = None
    episodes: int | None = None
    successes: int | None = None
    success_rate: float | None = None
    mean_score: float | None = None

    def with_layouts(self, path: Path, layouts: Sequence[LayoutResult]) -> HandOverAnswer:
        """Return the answer with the benchmark's result of each layout."""
        won, count = sum(layout.success for layout in layouts), len(layouts)
        return replace(
            self,
            result=str(path),
            episodes=count,
            successes=won,
            success_rate=won / count if count else None,
            mean_score=sum(layout.score for layout in layouts) / count if count else None,
        )

    def text(self) -> str:
        """Return the answer in a sentence."""
        if self.rehearsal:
            return f"{self.policy} completed a rehearsal of {self.bench_name}, which gives no numbers"
        where = f"{self.policy} on {self.bench_name}/{self.task}"
        if self.episodes is None:
            return f"{where}: success rate {self.success_rate:.3g}"
        return f"{where}: {self.successes} of {self.episodes} succeeded, mean score {self.mean_score or 0:.2f}"
