"""A rule that compares answers does not pass where they are alike whatever is shown."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from xpl_cli.audit.engine import engine
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.options import AuditOptions

if TYPE_CHECKING:
    from pathlib import Path

MODEL = """
import numpy as np


class Model:
    def __init__(self, config):
        self.shown = {{}}

    def update_obs(self, obs):
        self.shown = {{0: obs}}

    def update_obs_batch(self, obs_list):
        self.shown = {{obs["env_idx"]: obs for obs in obs_list}}

    def step(self, obs):
        value = np.asarray(obs["state"]["left_arm_joint_state"]) * {share}
        return {{"left_arm_joint_state": value, "left_ee_joint_state": np.ones(1)}}

    def get_action(self):
        return [self.step(*self.shown.values())]

    def get_action_batch(self, env_idx_list=None):
        return [[self.step(self.shown[env])] for env in (self.shown if env_idx_list is None else env_idx_list)]

    def reset(self):
        self.shown = {{}}
"""


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("share", "outcome"), [(0, "not_applicable"), (1, "pass")])
def test_equal_answers_prove_something_only_of_who_listens(tmp_path: Path, share: int, outcome: str) -> None:
    package = tmp_path / "Plain"
    package.mkdir()
    (package / "model.py").write_text(MODEL.format(share=share))
    (package / "deploy.yml").write_text("policy_name: Plain\nenv_cfg_type: arx_x5\naction_type: joint\nprotocol: ws\n")
    report = engine.audit(
        package, "policy", AuditOptions(gates=(Gate.OFFLINE,), names=("XPL203", "XPL204"), keep_going=True)
    )
    (gate,) = report.gates
    results = {result.slug: result.outcome.value for result in gate.results}
    assert results["batch-order"] == outcome
    assert results["batch-none-and-empty"] == outcome
