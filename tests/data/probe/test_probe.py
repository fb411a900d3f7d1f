"""The probe finds conventions of differently written sets of real motion, and claims nothing that is not so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml

from tests.data.probe.expected import judge
from tests.data.probe.probe_datasets import LAST, NEW, ONE, TUNED
from tests.support.recordings.demonstrations import Convention, MemorySet, write
from tests.support.recordings.motion import Motion, motion
from xpl_cli.data.probe import draft, page
from xpl_cli.data.probe.answer import MARGIN, HypothesisRanking
from xpl_cli.data.probe.probe import ProbeResult, probe
from xpl_cli.standard import validate

pytest.importorskip("mujoco")

OPEN = {
    "tcp in the base, wxyz": {"robot"},  # three robots of one arm have it there
    "two arms, rpy": {"robot"},  # likewise the left one
    "degrees, delta to state": {"gripper direction"},  # only two episodes have a grasp
    "axis-angle, fingers, delta to state": {"gripper direction", "rotation form"},  # ... and turns are small
    "delta to state, mean-std": {"gripper direction"},
    "every second step, late": {"kind", "angle unit"},  # six numbers without a name
    "axis-angle, body deltas, no joints": {"rotation form", "frame", "point"},
}
"""Topics that may stay unknown in a set, each for a reason."""


def _made(written: tuple[tuple[tuple[str, str, int], ...], Convention]) -> tuple[ProbeResult, list[Motion], Convention]:
    motions, how = written
    trajectory = [motion(*one) for one in motions]
    return probe(write(trajectory, how)), trajectory, how


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", TUNED)
def test_every_convention_is_found(name: str) -> None:
    """Nothing is claimed wrongly, and nothing is unknown that could be known."""
    result, played, how = _made(TUNED[name])
    _, wrong, missing = judge(result, played, how)
    assert not wrong
    assert {told.partition(" of ")[0] for told in missing} <= OPEN.get(name, set())


@pytest.mark.slow
@pytest.mark.parametrize("name", [*NEW, *LAST])
def test_nothing_is_claimed_wrongly_of_sets_that_nothing_was_tuned_on(name: str) -> None:
    """Other tasks, robots and conventions."""
    result, played, how = _made({**NEW, **LAST}[name])
    right, wrong, _ = judge(result, played, how)
    assert right
    assert not wrong


def _still() -> MemorySet:
    """Return sets of numbers that say nothing: noise for commands."""
    made = write([motion(*one) for one in ONE[:2]], Convention())
    rng = np.random.default_rng(0)
    for episode in made.episodes:
        episode.numbers["action"] = np.cumsum(rng.normal(0, 0.02, episode.numbers["action"].shape), axis=0)
    return made


def test_commands_that_lead_nowhere_have_no_reference() -> None:
    result = probe(_still())
    references = [one for one in result.answers if one.topic in {"reference", "order"} and one.is_known]
    assert not references
    assert all(one.needs for one in result.answers if not one.is_known)


def test_the_next_state_as_command_is_told() -> None:
    """What a recorder without access to commands writes."""
    made = write([motion(*one) for one in ONE[:2]], Convention())
    for episode in made.episodes:
        rows = episode.numbers["observation.state"]
        episode.numbers["action"] = np.concatenate([rows[1:], rows[-1:]])
    (answer,) = [one for one in probe(made).answers if one.topic == "latency"]
    assert answer.evidence == "commands are the state of the next step"


def test_latency_grows_by_the_steps_that_commands_are_late() -> None:
    played = [motion(*one) for one in ONE[:2]]
    plain, other = (probe(write(played, replace(Convention(), late=steps))) for steps in (0, 2))
    first, second = (result.value("latency", "action[0:7]") for result in (plain, other))
    assert second - first == pytest.approx(2, abs=0.3)


def test_a_set_that_says_another_rate_than_its_times_is_contradicted() -> None:
    """Times are believed, and the answer says so."""
    made = write([motion(*one) for one in ONE[:2]], Convention(stamps=("timestamp", 1.0)), rate_hz=10.0)
    answer = probe(made).of("rate", "set")
    assert answer is not None
    assert answer.value == pytest.approx(25.0)
    assert "it contradicts the dataset's 10 Hz" in answer.evidence


def test_a_draft_is_a_model_io_block_and_what_is_open_says_why() -> None:
    """It fits its schema, and holds what was measured."""
    motions, how = TUNED["pose xyzw beside joints"]
    result = probe(write([motion(*one) for one in motions], how))
    made = yaml.safe_load(draft.draft_yaml(result))
    assert not validate.validate(made["model_io"], "model_io")
    parts = made["model_io"]["action"]["parts"]
    assert made["model_io"]["action"]["reference"] == "absolute"
    assert parts[1]["rotation"]["form"] == "quaternion_xyzw"
    assert parts[2]["gripper"] == {"arm": "single", "closed": 0.0, "open": 1.0}
    assert made["embodiment"] == {"robot": "franka_single"}
    plain = yaml.safe_load(draft.draft_yaml(probe(write([motion(*one) for one in ONE[:2]], Convention()))))
    assert plain["embodiment"]["arm"]["dof"] == 7


def test_a_page_holds_every_answer_and_reaches_nothing() -> None:
    """Names of a file are text in it."""
    made = write([motion(*one) for one in ONE[:2]], Convention())
    for episode in made.episodes:
        episode.numbers["<b>action"] = episode.numbers.pop("action")
    result = probe(made)
    text = page.page(result, "a set")
    assert all(one.topic in text for one in result.answers)
    assert "<b>action" not in text
    assert "http" not in text


def test_a_margin_is_over_the_best_with_another_value() -> None:
    """Hypotheses that differ elsewhere are no rivals."""
    errors = {
        (("form", "a"), ("frame", "x")): 0.1,
        (("form", "a"), ("frame", "y")): 0.11,
        (("form", "b"), ("frame", "x")): 0.4,
    }
    ranking = HypothesisRanking(errors)
    assert ranking.judge("form") == ("a", pytest.approx(4.0), "b")
    assert ranking.judge("frame")[1] < MARGIN
