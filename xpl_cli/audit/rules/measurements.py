"""Success rates and scores over whole episodes, with confidence intervals."""

from __future__ import annotations

from dataclasses import dataclass

from xpl import _spec as sdk
from xpl_cli.evaluation.statistics.intervals import Interval, wilson

ENVIRONMENT = "mujoco"
"""The environment in which an audit measures."""


@dataclass(frozen=True)
class RolloutSetup:
    """Task, robot and setting of a rollout.

    Attributes:
        task: a task of the environment.
        embodiment: the robot.
        action_type: joint or end-effector control.
        setting: a setting of the environment; None for its first.
    """

    task: str
    embodiment: str
    action_type: str
    setting: str | None = None

    def __str__(self) -> str:
        setting = "" if self.setting is None else f", {self.setting}"
        return f"{self.task} ({self.embodiment}, {self.action_type}{setting})"


@dataclass(frozen=True)
class SuccessMeasurement:
    """A success rate and a mean score, measured over whole episodes.

    Attributes:
        setup: task, robot and setting.
        episodes: number of episodes.
        successes: number of successful ones.
        mean_score: mean of their scores, 0..1.
    """

    setup: RolloutSetup
    episodes: int
    successes: int
    mean_score: float

    @property
    def success_rate(self) -> float:
        """Share of the episodes that succeeded."""
        return self.successes / self.episodes

    @property
    def success_interval(self) -> Interval:
        """95 % confidence interval of the success rate."""
        return wilson(self.success_rate, self.episodes)

    @property
    def score_interval(self) -> Interval:
        """Confidence interval of the mean score, 95 % or more."""
        return wilson(self.mean_score, self.episodes)

    def __str__(self) -> str:
        return (
            f"{self.setup}: {self.successes} of {self.episodes} episodes succeed ({self.success_interval}), "
            f"mean score {self.mean_score:.2f} ({self.score_interval.low:.2f} to {self.score_interval.high:.2f})"
        )

    def as_json(self) -> dict[str, object]:
        """Return the measurement as a dict of plain values."""
        setup = self.setup
        return {
            "environment": ENVIRONMENT,
            "task": setup.task,
            "embodiment": setup.embodiment,
            sdk.Deploy.ACTION_TYPE: setup.action_type,
            "setting": setup.setting,
            "episodes": self.episodes,
            "successes": self.successes,
            "success_rate": self.success_rate,
            "success_interval": list(self.success_interval),
            "mean_score": self.mean_score,
            "score_interval": list(self.score_interval),
        }
