"""Every word of the model_io vocabulary is used by a block that is valid, compiles, and converts there and back."""

from __future__ import annotations

from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.adapters.model_io import CAMERAS, CASES, Case, observation, steps, vocabulary, words
from xpl import rotation
from xpl_cli.standard import spec

SCHEMA = spec.schema("model_io")
NAMES = pytest.mark.parametrize("case", CASES.values(), ids=CASES)
SEEDS = st.integers(0, 10_000)
SIZES = dict.fromkeys(CAMERAS, (24, 32))
FEW = settings(max_examples=8, derandomize=True, deadline=None)


def test_no_word_is_left_out() -> None:
    used = {word for case in CASES.values() for word in words(SCHEMA, case.model_io, SCHEMA)}
    assert vocabulary(SCHEMA) - used == set()


@NAMES
def test_the_cases_are_valid(case: Case) -> None:
    jsonschema.Draft202012Validator(SCHEMA).validate(case.model_io)


@NAMES
def test_a_state_is_the_same_there_and_back(case: Case) -> None:
    _state_round_trip(case, 3)


@FEW
@given(st.sampled_from(sorted(CASES)), SEEDS)
def test_every_state_is_the_same_there_and_back(name: str, seed: int) -> None:
    _state_round_trip(CASES[name], seed)


def _state_round_trip(case: Case, seed: int) -> None:
    interface = case.compiled()
    obs, other = observation(case.robot, seed), observation(case.robot, seed + 1)
    inputs = interface.encode(obs, {})
    back = interface.observe(inputs, other)
    again = interface.encode(back, {})
    for name in interface.states:
        assert np.allclose(again[name], inputs[name], atol=2e-4), name
    parts = [item for vector in interface.states.values() for item in vector.parts]
    kinds = {item.key: {one.kind for one in parts if one.key == item.key} for item in parts if item.key}
    for key in (key for key, told in kinds.items() if told not in ({"position"}, {"rotation"})):
        _alike(key, back["state"][key], obs["state"][key])


@NAMES
def test_an_image_is_the_same_there_and_back(case: Case) -> None:
    interface = case.compiled()
    inputs = interface.encode(observation(case.robot, 5), {})
    for item in interface.images:
        shown = {camera: {"color": image} for camera, image in item.decode(inputs[item.name], SIZES).items()}
        value, again = inputs[item.name], item.encode({"vision": shown})
        assert (value.shape, value.dtype) == (again.shape, again.dtype)
        spread = float(value.max()) - float(value.min())
        assert np.abs(value.astype(float) - again).mean() < 0.012 * spread, item.name
        assert all(view["color"].dtype == np.uint8 for view in shown.values())


@FEW
@given(st.sampled_from(sorted(CASES)), SEEDS, st.integers(1, 4))
def test_commands_are_the_same_there_and_back(name: str, seed: int, count: int) -> None:
    case = CASES[name]
    interface, rng = case.compiled(), np.random.default_rng(seed)
    interface.action.steps = count
    there: dict[str, Any] = {}
    back: dict[str, Any] = {}
    for call in range(2):
        state = observation(case.robot, seed + call)["state"]
        wanted = steps(case, rng, count)
        raw = interface.action.encode(wanted, state, there)
        assert raw.shape == (interface.action.first + count, interface.action.vector.padded)
        found = interface.action.decode(raw, state, back)
        for one, other in zip(found, wanted, strict=True):
            for key, value in other.items():
                _alike(key, one[key], value)


@FEW
@given(st.sampled_from(["two arms, joint deltas", "one arm, cumulative poses", "rows", "hands, absolute"]), SEEDS)
def test_answers_are_the_same_there_and_back(name: str, seed: int) -> None:
    case = CASES[name]
    interface, rng = case.compiled(), np.random.default_rng(seed)
    state = observation(case.robot, seed)["state"]
    raw = interface.action.encode(steps(case, rng, 3), state)
    again = interface.action.encode(interface.action.decode(raw, state), state)
    assert np.allclose(again, raw, atol=3e-5)


def _alike(key: str, found: Any, wanted: Any) -> None:
    if key.endswith("ee_pose"):
        assert np.allclose(found[:3], wanted[:3], atol=2e-5), key
        assert float(rotation.angle_between(rotation.normalise(found[3:]), wanted[3:])) < 1e-4, key
    else:
        assert np.allclose(found, wanted, atol=1e-4), key
