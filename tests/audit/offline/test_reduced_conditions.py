"""A rule that had too little to judge does not pass: it is not applicable, and its reason says what lacked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from xpl.checkpoint import TINY
from xpl_cli.audit.engine import engine
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.scaffold import adapter
from xpl_cli.scaffold.answers import AdapterAnswers

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.audit.rules.model import RuleResult

MODEL = """
import numpy as np


class Model:
    STEPS = 3

    def __init__(self, config):
        self.speed = config.get("speed", 1.0)
        self.held = {}

    def update_obs(self, obs):
        self.update_obs_batch([obs])

    def update_obs_batch(self, obs_list):
        named = ["env_idx" in obs for obs in obs_list]
        if any(named) != all(named):
            raise ValueError("some observations lack env_idx")
        self.held = {obs.get("env_idx", place): obs for place, obs in enumerate(obs_list)}

    def value(self, obs):
        picture = np.asarray(obs["vision"]["cam_head"]["color"], float)
        words = obs.get("instruction") or obs["instructions"]
        words = words if isinstance(words, str) else words[0]
        return np.asarray(obs["state"]["arm_joint_state"], float) + picture.mean() / 1e4 + len(words) / 1e3

    def chunk(self, obs):
        value = self.value(obs).astype(np.float32)
        opening = np.ones(1, np.float32)
        return [{"arm_joint_state": value, "ee_joint_state": opening} for _ in range(self.STEPS)]

    def get_action(self):
        return self.chunk(next(iter(self.held.values())))

    def get_action_batch(self, env_idx_list=None):
        wanted = list(self.held) if env_idx_list is None else env_idx_list
        if len(set(wanted)) < len(wanted):
            raise ValueError("listed twice")
        return [self.chunk(self.held[env]) for env in wanted]

    def reset(self):
        self.held = {}
"""
CONSTANT = """
    def value(self, obs):
        obs["state"]["arm_joint_state"]
        return np.zeros(6)
"""
BLIND = """
    def value(self, obs):
        return np.asarray(obs["state"]["arm_joint_state"], float)
"""
TAKES_ANYTHING = """
    def value(self, obs):
        state = obs.get("state")
        joints = state.get("arm_joint_state") if isinstance(state, dict) else None
        return np.zeros(6) if joints is None else np.asarray(joints, float)

    def get_action_batch(self, env_idx_list=None):
        wanted = list(self.held) if env_idx_list is None else env_idx_list
        return [self.chunk(self.held.get(env, {})) for env in wanted]
"""
NO_BATCHES = """
    def get_action_batch(self, env_idx_list=None):
        raise NotImplementedError("one environment only")
"""
ONE_STEP = """
    STEPS = 1
"""
DEPLOY = "policy_name: Plain\nenv_cfg_type: arx_x5_single\naction_type: joint\nprotocol: ws\nspeed: 1.0\n"


def _results(package: Path, rules: tuple[str, ...], **options: Any) -> dict[str, RuleResult]:
    """Run rules of the offline gate, each without those that it comes after."""
    report = engine.audit(package, "policy", AuditOptions(gates=(Gate.OFFLINE,), names=rules, **options))
    (gate,) = report.gates
    return {result.slug: result for result in gate.results}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "reasons"),
    [
        pytest.param(
            CONSTANT,
            {
                "batch-order": "get the same actions",
                "batch-none-and-empty": "get the same actions",
                "batch-without-index": "get the same actions",
                "repeated-inference": "do not depend on observations",
                "after-an-error": "do not depend on observations",
                "seed-repeats": "do not depend on observations",
                "null-means-absent": "do not depend on observations",
                "cut-connection": "the same in every step",
            },
            id="constant",
        ),
        pytest.param(
            BLIND,
            {
                "image-transport": "the actions depend on no image",
                "instruction-forms": "the instruction does not change the actions",
            },
            id="inputs without effect",
        ),
        pytest.param(TAKES_ANYTHING, {"after-an-error": "refuses none"}, id="no error occurs"),
        pytest.param(
            NO_BATCHES,
            {
                "batch-none-and-empty": "XPL203 reports",
                "batch-unknown": "XPL203 reports",
                "batch-without-index": "XPL203 reports",
                "batch-independent": "XPL203 reports",
            },
            id="one environment only",
        ),
        pytest.param(ONE_STEP, {"step-size": "one action", "trial-hooks": "defines"}, id="one step"),
    ],
)
def test_what_cannot_be_judged_is_not_passed(tmp_path: Path, changes: str, reasons: dict[str, str]) -> None:
    """With all that is needed, the same rules pass."""
    package = tmp_path / "Plain"
    package.mkdir()
    (package / "deploy.yml").write_text(DEPLOY)
    (package / "model.py").write_text(MODEL + changes)
    results = _results(package, tuple(reasons))
    assert {slug: results[slug].outcome.value for slug in reasons} == dict.fromkeys(reasons, "not_applicable")
    assert all(text in str(results[slug].reason) for slug, text in reasons.items()), results
    (package / "model.py").write_text(MODEL)
    judged = {slug: result.outcome.value for slug, result in _results(package, tuple(reasons)).items()}
    expected = {slug: "not_applicable" if slug == "trial-hooks" else "pass" for slug in reasons}
    assert {slug: judged[slug] for slug in reasons} == expected


@pytest.mark.slow
def test_a_pass_in_shadow_mode_proves_nothing_of_what_loading_does(tmp_path: Path) -> None:
    """Its ports and processes, its random numbers and the files that load reads; packing is judged all the same."""
    rules = ("opens-port", "leftover-processes", "worker-crash", "seed-repeats", "any-working-directory")
    adapter.write(adapter.render(AdapterAnswers(**{**adapter.defaults(), "name": "Plain"})), tmp_path / "Plain")
    full = _results(tmp_path / "Plain", (*rules, "batch-order"))
    assert {result.outcome.value for result in full.values()} == {"pass"}
    shadow = _results(tmp_path / "Plain", (*rules, "batch-order"), profile=Profile.SHADOW)
    assert {slug: shadow[slug].outcome.value for slug in rules} == dict.fromkeys(rules, "not_applicable")
    assert shadow["batch-order"].outcome.value == "pass"


@pytest.mark.slow
@pytest.mark.parametrize(("is_tiny", "outcome"), [(False, "pass"), (True, "not_applicable")])
def test_tiny_weights_are_no_measure_of_time(tmp_path: Path, *, is_tiny: bool, outcome: str) -> None:
    """A tiny random checkpoint is loaded and answers in no time."""
    package = tmp_path / "Plain"
    adapter.write(adapter.render(AdapterAnswers(**{**adapter.defaults(), "name": "Plain"})), package)
    for name, old, new in (
        ("policy.yml", "control_frequency: null", "control_frequency: 20"),
        ("deploy.yml", "ckpt_name: null", "ckpt_name: small"),
    ):
        text = (package / name).read_text(encoding="utf-8")
        assert old in text
        (package / name).write_text(text.replace(old, new), encoding="utf-8")
    checkpoint = package / "checkpoints" / "small"
    checkpoint.mkdir(parents=True)
    (checkpoint / (TINY if is_tiny else "weights.json")).write_text("{}", encoding="utf-8")
    results = _results(package, ("inference-rate", "ready-before-loaded"))
    assert {results[slug].outcome.value for slug in ("inference-rate", "ready-before-loaded")} == {outcome}, results
