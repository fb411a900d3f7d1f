"""What came of a hand-over: `xpl.env-hand-over/1`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from xpl_cli.evaluation.hand_over.results import LayoutResult


@dataclass(frozen=True)
class HandOverAnswer:
    """What was played, by which command, and what came of it.

    Attributes:
        environment, bench_name, policy, task, embodiment, action_type: what was played.
        run_id: name of the run.
        rehearsal: whether it was a rehearsal, which gives no numbers.
        command: words that launched it.
        seconds: how long it took.
        result: the file that the benchmark left.
        episodes, successes, mean_score: None where the benchmark tells a rate only.
        success_rate: None where there is no episode, too.
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
        """Return the answer with what the benchmark says of each layout."""
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
            return f"{self.policy} ran to the end of a rehearsal of {self.bench_name}, which tells no numbers"
        where = f"{self.policy} on {self.bench_name}/{self.task}"
        if self.episodes is None:
            return f"{where}: success rate {self.success_rate:.3g}"
        return f"{where}: {self.successes} of {self.episodes} succeeded, mean score {self.mean_score or 0:.2f}"
