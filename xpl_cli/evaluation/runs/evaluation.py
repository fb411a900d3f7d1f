"""The result of an evaluation without a record: `xpl.eval/1` (spec/v1/evaluation.schema.json)."""

from __future__ import annotations

import shlex
from collections import Counter
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl.vector import INFRASTRUCTURE
from xpl_cli.evaluation.records import mock_settings
from xpl_cli.evaluation.records.model import EpisodeOutcome, EpisodeRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

SCHEMA: Final = "xpl.eval/1"
_REPORTED: Final = ("task", "setting", sdk.Deploy.SEED, *(item.name for item in fields(EpisodeOutcome)))
_NULL: Final = ("success", "score", "failure", "end_reason")


@dataclass(frozen=True)
class EvalSetup:
    """What was run, and how.

    Attributes:
        policy, environment, task, setting, embodiment, action_type: of the rollouts; several tasks as requested.
        num_envs: environments in one batch.
        workers: processes that shared them; 0: none of their own.
        horizon: execution horizon, at most; None: the adapter's own loop.
    """

    policy: str
    environment: str
    task: str | None
    setting: str
    embodiment: str
    action_type: str
    num_envs: int = 1
    workers: int = 0
    horizon: int | None = None


@dataclass(frozen=True)
class Evaluation:
    """The result.

    Attributes:
        setup: what was run.
        episodes: the final attempt at each, in the order of the plan.
        attempts: number of attempts by index of the episode.
        seconds: duration of all.
    """

    setup: EvalSetup
    episodes: Sequence[EpisodeRecord]
    attempts: Mapping[int, int] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def successes(self) -> int | None:
        """Number of episodes that succeeded; None if none defines success."""
        return _successes(self.episodes) if self._with_success else None

    @property
    def infrastructure_errors(self) -> int:
        """Number of episodes that ended with an infrastructure error in every attempt."""
        return sum(episode.end_reason == INFRASTRUCTURE for episode in self.episodes)

    @property
    def success_rate(self) -> float | None:
        """Success rate, with infrastructure errors as failures; None if no episode defines success."""
        return _successes(self.episodes) / self._denominator if self._with_success else None

    @property
    def mean_score(self) -> float | None:
        """Mean score, 0 for infrastructure errors; None if no episode defines success."""
        judged = self._with_success
        return sum(episode.score or 0.0 for episode in judged) / self._denominator if judged else None

    def as_json(self) -> dict[str, Any]:
        """Return `xpl.eval/1`."""
        corrections: Counter[str] = Counter()
        for episode in self.episodes:
            corrections.update(episode.corrections or {})
        return {
            "schema": SCHEMA,
            **asdict(self.setup),
            "episodes": [self._episode_json(episode) for episode in self.episodes],
            "successes": self.successes,
            "success_rate": self.success_rate,
            "infrastructure_failures": self.infrastructure_errors,
            "mean_score": self.mean_score,
            "corrections": dict(corrections),
            "seconds": round(self.seconds, 3),
        }

    def text(self) -> str:
        """Return the report as one line for people, with one more for each task where there are several."""
        setup, count = self.setup, len(self.episodes)
        what = f"{setup.environment}/{setup.task}, {setup.embodiment}, {setup.action_type} control"
        where = f"{setup.policy} on {what}"
        unreal = mock_settings.remark(setup.environment, [setup.setting])
        remarks = [] if unreal is None else [unreal]
        if self.success_rate is None:
            return "\n".join([f"{where}: {count} episodes ran to their end in {self.seconds:.1f} s", *remarks])
        score = f"mean score {self.mean_score:.2f}"
        tasks: dict[str, list[EpisodeRecord]] = {}
        for episode in self.episodes:
            tasks.setdefault(episode.task, []).append(episode)
        lines = [f"{where}: {self.successes} of {count} succeeded, {score}, {self.seconds:.1f} s"]
        if len(tasks) > 1:
            lines += [f"  {task}: {_successes(episodes)} of {len(episodes)}" for task, episodes in tasks.items()]
        return "\n".join([*lines, *remarks])

    def following(self, policy: str) -> list[str]:
        """Return the exact commands that come next.

        Args:
            policy: the adapter, as it was named.
        """
        if self.infrastructure_errors:
            return ["xpl doctor"]
        if self.successes == 0:
            return [shlex.join(["xpl", "audit", policy, "--gate", "mujoco"])]
        return []

    @property
    def _with_success(self) -> list[EpisodeRecord]:
        """The episodes that define success."""
        return [episode for episode in self.episodes if episode.success is not None]

    @property
    def _denominator(self) -> int:
        return len(self._with_success) + self.infrastructure_errors

    def _episode_json(self, episode: EpisodeRecord) -> dict[str, Any]:
        fields = {name: getattr(episode, name) for name in _REPORTED}
        return {
            sdk.Obs.ENV_IDX: episode.index % self.setup.num_envs,
            **{name: value for name, value in fields.items() if value is not None or name in _NULL},
            "attempts": self.attempts.get(episode.index, 1),
        }


def progress_line(episodes: Sequence[EpisodeRecord], total: int) -> str:
    """Return how far an evaluation has come."""
    judged = sum(episode.success is not None for episode in episodes)
    suffix = f", {_successes(episodes)} of {judged} succeeded" if judged else ""
    return f"episode {len(episodes)} of {total}{suffix}"


def _successes(episodes: Iterable[EpisodeRecord]) -> int:
    return sum(bool(episode.success) for episode in episodes)
