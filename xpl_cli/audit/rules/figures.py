"""Success rates and scores over whole episodes: what was measured, in what, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass

from xpl import _spec as sdk
from xpl_cli.evaluation.statistics.intervals import Interval, wilson

ENVIRONMENT = "mujoco"
"""The environment in which an audit measures."""


@dataclass(frozen=True)
class Course:
    """What is driven.

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
class Figure:
    """What was measured.

    Attributes:
        course: what was driven.
        episodes: how many episodes.
        successes: how many of them succeeded.
        mean_score: mean of their scores, 0..1.
    """

    course: Course
    episodes: int
    successes: int
    mean_score: float

    @property
    def success_rate(self) -> float:
        """Share of the episodes that succeeded."""
        return self.successes / self.episodes

    @property
    def success_interval(self) -> Interval:
        """Where the success rate lies, with 95 % confidence."""
        return wilson(self.success_rate, self.episodes)

    @property
    def score_interval(self) -> Interval:
        """Where the mean score lies, with 95 % confidence or more."""
        return wilson(self.mean_score, self.episodes)

    def __str__(self) -> str:
        return (
            f"{self.course}: {self.successes} of {self.episodes} episodes succeed ({self.success_interval}), "
            f"mean score {self.mean_score:.2f} ({self.score_interval.low:.2f} to {self.score_interval.high:.2f})"
        )

    def as_json(self) -> dict[str, object]:
        """Return the figure as a map of plain values."""
        course = self.course
        return {
            "environment": ENVIRONMENT,
            "task": course.task,
            "embodiment": course.embodiment,
            sdk.Deploy.ACTION_TYPE: course.action_type,
            "setting": course.setting,
            "episodes": self.episodes,
            "successes": self.successes,
            "success_rate": self.success_rate,
            "success_interval": list(self.success_interval),
            "mean_score": self.mean_score,
            "score_interval": list(self.score_interval),
        }
