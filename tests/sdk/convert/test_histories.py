"""Histories of different inputs: a compiled block shows what a plain loop over the episode shows."""

from __future__ import annotations

import copy
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.adapters.model_io import observation
from tests.support.examples import examples
from xpl.convert import ConversionError, compile_interface
from xpl.convert.gaps import fill_gaps, gaps
from xpl.embodiment import get_embodiment
from xpl.manifest import Manifest
from xpl.policy import Policy
from xpl_cli.packages.conventions import HISTORY, applicable_conventions
from xpl_cli.standard import spec

ROBOT = get_embodiment("franka_single")
ACTION: dict[str, Any] = {
    "reference": "absolute",
    "parts": [{"joints": {"arm": "single"}}, {"gripper": {"arm": "single", "closed": 0.0, "open": 1.0}}],
}
JOINTS: dict[str, Any] = {"parts": [{"joints": {"arm": "single"}}]}
IMAGE: dict[str, Any] = {"cameras": ["cam_head"], "channels": "rgb", "layout": "hwc", "dtype": "uint8"}
VALID = jsonschema.Draft202012Validator(spec.schema("model_io"))


def _history(mask: str) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries(
        {"length": st.integers(1, 4)},
        optional={
            "stride": st.integers(1, 3),
            "order": st.sampled_from(["oldest_first", "newest_first"]),
            "pad": st.sampled_from(["repeat", "zeros"]),
            "mask": st.just(mask),
        },
    )


@st.composite
def _blocks(draw: st.DrawFn) -> dict[str, Any]:
    """Draw a block of two images and three vectors, each with a history of its own or without."""
    block: dict[str, Any] = {"action": ACTION}
    for kind, shared, count in (("images", IMAGE, 2), ("state", JOINTS, 3)):
        own = [draw(st.none() | _history(f"real_{kind}_{index}")) for index in range(count)]
        block[kind] = [
            {"input": f"{kind}_{index}", **shared, **({} if one is None else {"history": one})}
            for index, one in enumerate(own)
        ]
    if draw(st.booleans()):
        of = draw(st.none() | st.sampled_from([["images"], ["state"], ["images", "state"]]))
        block["history"] = {**draw(_history("real")), **({} if of is None else {"of": of})}
    return block


def _at(number: int, env: int = 0) -> dict[str, Any]:
    obs = {**observation("franka_single", size=(2, 3)), "env_idx": env}
    obs["state"]["arm_joint_state"] = np.full(7, number, np.float64)
    obs["vision"]["cam_head"]["color"] = np.full((2, 3, 3), number, np.uint8)
    return obs


def _looped(history: dict[str, Any], numbers: list[int]) -> tuple[list[int], list[int]]:
    """Return what a history shows of an episode's numbers, and which of them are real."""
    seen, real = [], []
    for back in reversed(range(history["length"])):
        place = len(numbers) - 1 - back * history.get("stride", 1)
        padding = 0 if history.get("pad") == "zeros" else numbers[0]
        seen.append(numbers[place] if place >= 0 else padding)
        real.append(int(place >= 0))
    return (seen[::-1], real[::-1]) if history.get("order") == "newest_first" else (seen, real)


def _expected(block: dict[str, Any], numbers: list[int]) -> dict[str, Any]:
    """Return by input the numbers that a model sees: one, or a list where the input has an axis of time."""
    common = block.get("history", {"length": 1})
    expected: dict[str, Any] = {}
    for kind in ("images", "state"):
        default = common if kind in common.get("of", ["images", "state"]) else {"length": 1}
        for entry in block[kind]:
            history = entry.get("history", default)
            seen, real = _looped(history, numbers)
            expected[entry["input"]] = seen[0] if history["length"] == 1 else seen
            if "mask" in entry.get("history", {}):
                expected[history["mask"]] = real
    if "mask" in common:
        expected[common["mask"]] = _looped(common, numbers)[1]
    return expected


def _shown(value: np.ndarray, name: str) -> Any:
    """Return the numbers of one environment's input, which are equal over the axes of the input itself."""
    if name.startswith("real"):
        return value.astype(int).tolist()
    return value.max(axis=tuple(range(-3 if name.startswith("images") else -1, 0))).astype(int).tolist()


@settings(max_examples=examples(120), deadline=None)
@given(_blocks(), st.integers(1, 12), st.integers(1, 12))
def test_a_compiled_block_shows_what_a_loop_shows(block: dict[str, Any], one: int, other: int) -> None:
    """For two environments at once, one of which may be younger than the longest history."""
    VALID.validate(block)
    interface = compile_interface(block, ROBOT, "joint")
    episodes = [list(range(1, 1 + one)), list(range(101, 101 + other))]
    batch = interface.batch([[interface.encode(_at(n)) for n in numbers][-interface.span :] for numbers in episodes])
    for place, numbers in enumerate(episodes):
        assert {name: _shown(values[place], name) for name, values in batch.items()} == _expected(block, numbers)
    assert Manifest.parse({"model_io": block}).reach == interface.span


class Adapter(Policy):
    """Keeps what it was given."""

    given: Any

    def predict(self, inputs: Any, envs: list[int]) -> np.ndarray:
        self.given = inputs
        return np.zeros((len(envs), 1, 8))


@settings(max_examples=examples(60), deadline=None)
@given(_blocks(), st.lists(st.booleans(), min_size=1, max_size=12))
def test_a_policy_keeps_what_the_longest_history_needs(block: dict[str, Any], asked: list[bool]) -> None:
    """Whether it was asked about the observations before or not, and anew after a reset."""
    config = {"env_cfg_type": "franka_single", "action_type": "joint", "manifest": {"model_io": block}}
    policy = Adapter(config)
    for begin in (1, 101):
        policy.reset()
        for count, is_asked in enumerate([*asked, True], start=1):
            policy.update_obs(_at(begin + count - 1))
            if is_asked:
                policy.get_action()
                found = {name: _shown(values[0], name) for name, values in policy.given.items()}
                assert found == _expected(block, list(range(begin, begin + count)))


def test_a_history_of_one_is_the_newest_alone() -> None:
    block = {"action": ACTION, "state": [{"input": "q", **JOINTS, "history": {"length": 1}}], "history": {"length": 3}}
    interface = compile_interface(block, ROBOT, "joint")
    assert interface.history_of("q") is None
    assert interface.history_of("of an adapter's own encode").length == 3  # type: ignore[union-attr]
    assert interface.batch([interface.encode(_at(5))])["q"].shape == (1, 7)


@pytest.mark.parametrize("key", ["length", "stride", "order", "pad"])
@pytest.mark.parametrize("place", [("history",), ("images", 0, "history"), ("state", 0, "history")])
def test_each_of_its_values_may_be_open(place: tuple[Any, ...], key: str) -> None:
    """An open one is named in the one sentence, and the rest of the block is tried without it."""
    block: dict[str, Any] = {"action": ACTION, "images": [{"input": "i", **IMAGE}], "state": [{"input": "q", **JOINTS}]}
    inner: Any = block
    for name in place[:-1]:
        inner = inner[name]
    inner[place[-1]] = {"length": 2, key: {"unknown": "not in the config"}}
    VALID.validate(block)
    (gap,) = gaps(block)
    with pytest.raises(ConversionError) as raised:
        compile_interface(block, ROBOT, "joint")
    assert f"leaves a value open that conversions need: {gap.where} (not in the config)" in str(raised.value)
    assert gap.where.endswith(f"history.{key}")
    interface = compile_interface(fill_gaps(block, ROBOT, "joint"), ROBOT, "joint")
    assert interface.batch([interface.encode(_at(1))])["q"].shape[-1] == 7

    settled = copy.deepcopy(block)
    history = settled
    for name in place:
        history = history[name]
    values = {"length": 3, "stride": 2, "order": "newest_first", "pad": "zeros"}
    history[key] = {"assumed": values[key], "why": "as in the paper"}
    VALID.validate(settled)
    manifest = Manifest.parse({"model_io": settled})
    assert [one.where for one in manifest.assumed] == [f"model_io.{gap.where}"]
    assert getattr(manifest.model_io.longest, key) == values[key]  # type: ignore[union-attr]


def test_masks_have_names_of_their_own() -> None:
    states = [{"input": name, **JOINTS, "history": {"length": 2, "mask": "real"}} for name in "ab"]
    with pytest.raises(ConversionError, match="an input is named twice: real"):
        compile_interface({"action": ACTION, "state": states}, ROBOT, "joint")


@pytest.mark.parametrize(
    ("model_io", "apply"),
    [
        ({"history": {"length": 2}}, True),
        ({"history": {"length": 1}}, False),
        ({"state": [{"input": "q", **JOINTS, "history": {"length": 2}}]}, True),
        ({"images": [{"input": "i", **IMAGE, "history": {"length": 1}}]}, False),
    ],
)
def test_a_history_anywhere_makes_four_conventions_apply(model_io: dict[str, Any], apply: bool) -> None:
    found = set(applicable_conventions(Manifest.parse({"model_io": {"action": ACTION, **model_io}})))
    assert found & set(HISTORY) == (set(HISTORY) if apply else set())
