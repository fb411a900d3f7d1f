"""Arguments of the trial hooks, for rules that call them: the same as in an evaluation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from xpl_cli.evaluation.records.model import EpisodeOutcome
from xpl_cli.evaluation.rollout import trial
from xpl_cli.evaluation.rollout.config import EnvSettings

if TYPE_CHECKING:
    from xpl.contract import Config
    from xpl_cli.audit.served.probe import Probe

RESULT: Final = trial.describe_outcome([EpisodeOutcome(success=False, score=0.25, steps=3, end_reason="max_steps")])
"""Result of a trial."""


def trial_case(probe: Probe) -> Config:
    """Return the arguments of `prepare_case` for the robot that the policy is served for."""
    return trial.describe_case(EnvSettings("task", probe.embodiment.name, probe.action_type, setting="setting"))
