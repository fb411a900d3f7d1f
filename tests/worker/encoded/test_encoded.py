"""Encoded inputs are changed: pictures, texts and vectors, within whatever the adapter's encode returns."""

from __future__ import annotations

from collections import namedtuple
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support.adapters.model_io import observation
from xpl import rotation
from xpl.catalogue import convention as catalogue
from xpl.catalogue.walk import NoEffectError, leaves, map_leaves
from xpl.conventions import instruction
from xpl.convert.images import ImageInput
from xpl.policy import Policy
from xpl.wire import packed
from xpl.worker.encoded import pictures, play, turns

if TYPE_CHECKING:
    from collections.abc import Mapping

LOW, HIGH = np.linspace(-2, -1, 8), np.linspace(1, 4, 8)
SIZE = (24, 32)
RNG = np.random.default_rng(0)


class Tensor:
    def __init__(self, array: np.ndarray) -> None:
        self.array = array
        self.shape, self.ndim, self.dtype = array.shape, array.ndim, array.dtype

    def detach(self) -> Any:
        return self

    cpu = detach

    def numpy(self) -> np.ndarray:
        return self.array

    def new_tensor(self, array: np.ndarray) -> Any:
        return Tensor(np.asarray(array))


Pair = namedtuple("Pair", "one other")  # noqa: PYI024 - of any types


def _changed(kind: str, value: Any, how: Any) -> Any:
    return catalogue.lookup("input_changes", kind)(value, how)


def test_all_that_encode_may_return_is_walked_through() -> None:
    value = {
        "a": np.ones(4, np.float32),
        "b": [Tensor(np.ones(3)), "text"],
        "c": Pair((1.0, 2.0), None),
        "d": 7,
    }
    assert [str(np.shape(leaf)) for leaf in leaves(value)] == ["(4,)", "(3,)", "()", "(2,)"]
    twice = map_leaves(value, lambda leaf: leaf + leaf)
    assert twice["a"].dtype == np.float32
    assert twice["a"].tolist() == [2.0] * 4
    assert twice["b"][0].array.tolist() == [2.0] * 3
    assert twice["b"][1] == "texttext"
    assert twice["c"] == Pair((2.0, 4.0), None)
    assert twice["d"] == 7
    assert value["a"].tolist() == [1.0] * 4


def test_black_and_white_become_others() -> None:
    of = [[0, 0, 0], [1, 1, 1]]
    to = [[-1, -2, -3], [1, 2, 3]]
    image = RNG.uniform(0, 1, (24, 32, 3)).astype(np.float32)
    for axes in ((0, 1, 2), (2, 0, 1)):
        result = _changed("scaled", {"i": image.transpose(axes)}, {"of": of, "to": to})["i"]
        assert np.allclose(result, ((2 * image - 1) * [1, 2, 3]).transpose(axes), atol=1e-5)
    with pytest.raises(NoEffectError, match="pictures from"):
        _changed("scaled", image * 255, {"of": of, "to": to})
    assert _changed("scaled", {"v": np.ones(9)}, {"of": of, "to": to})["v"].tolist() == [1.0] * 9


def test_axes_and_colours_are_exchanged() -> None:
    views = RNG.uniform(0, 1, (2, 24, 32, 3))
    assert (_changed("colours", views, {}) == views[..., ::-1]).all()
    assert _changed("layout", views, {"to": "chw"}).shape == (2, 3, 24, 32)
    assert _changed("layout", views, {"to": "hwc"}) is views
    assert _changed("turned", views, {}).shape == (2, 32, 24, 3)
    beside = RNG.uniform(0, 1, (20, 40, 3))
    below = _changed("beside", beside, {})
    assert (below == np.concatenate((beside[:, :20], beside[:, 20:]), 0)).all()
    assert (_changed("beside", below, {}) == beside).all()


def _seen(obs: Mapping[str, Any], *steps: dict[str, Any], turned: bool = False) -> np.ndarray:
    entry = {"input": "i", "cameras": ["cam_head"], "channels": "rgb", "layout": "chw", "dtype": "float32"}
    view = ImageInput({**entry, "steps": list(steps)}).encode(obs)
    return view[:, ::-1, ::-1] if turned else view


BOX = {"letterbox": {"to": [18, 18], "filter": "bilinear"}}
CUT = {"crop": {"fraction": 0.8}}
STRETCH = {"resize": {"to": [18, 18], "filter": "bicubic", "antialias": True}}


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("own", [[BOX], [STRETCH], [CUT, STRETCH], []])
def test_pictures_get_their_size_before_the_adapter(own: list[Any], turned: bool) -> None:
    obs = observation("franka_single", 3, (48, 64))
    if not own:
        obs = observation("franka_single", 3, (18, 18))

    def encode(seen: Mapping[str, Any]) -> Any:
        return [_seen(seen, *own, turned=turned)]

    wanted = {"filter": "area"}
    resized = pictures.ResizedInputs(encode, obs)
    shown = resized(obs, [{"resize": wanted}])
    assert np.allclose(encode(shown)[0], _seen(obs, {"resize": {**wanted, "to": [18, 18]}}, turned=turned))
    same = resized(obs, [{kind: how} for step in own for kind, how in step.items()])
    assert pictures.apart(encode(same), encode(obs)) < 0.01


def test_an_adapter_without_pictures_or_with_ways_of_its_own_is_left() -> None:
    obs = observation("franka_single", 3, (48, 64))
    with pytest.raises(NoEffectError, match="no pictures"):
        pictures.ResizedInputs(lambda _: np.ones(3), obs)
    with pytest.raises(NoEffectError, match="the adapter changes pictures"):
        pictures.ResizedInputs(lambda seen: _seen(seen, {"crop": {"fraction": 0.5}}, STRETCH), obs)


@pytest.mark.parametrize(
    ("written", "how", "wanted"),
    [
        (lambda text: text.lower(), {"case": "keep"}, "  Fold IT. "),
        (lambda text: f"Task: {text.strip()}\n", {"case": "lower", "strip": " "}, "Task: fold it.\n"),
        (lambda text: "", {"case": "keep", "strip": " "}, "Fold IT."),
        (lambda text: text, {"case": "lower", "strip": " ", "template": "do: {instruction}"}, "do: fold it."),
    ],
)
def test_the_instruction_within_a_prompt(written: Any, how: dict[str, Any], wanted: str) -> None:
    obs = observation("franka_single", instruction="  Fold IT. ")
    assert instruction.rewrite_texts({"p": written("  Fold IT. "), "n": np.ones(3)}, how, obs)["p"] == wanted
    with pytest.raises(NoEffectError, match="no text"):
        instruction.rewrite_texts({"n": np.ones(3)}, how, obs)


def test_orders_of_vectors() -> None:
    value = {"q": np.arange(4.0), "h": np.arange(8.0).reshape(2, 4), "i": np.zeros((24, 32, 3)), "r": np.arange(3.0)}
    result = _changed("ordered", value, {"order": [3, 0, 1, 2]})
    assert result["q"].tolist() == [3, 0, 1, 2]
    assert result["h"].tolist() == [[3, 0, 1, 2], [7, 4, 5, 6]]
    assert result["r"].tolist() == [0, 1, 2]
    with pytest.raises(NoEffectError, match="no vector"):
        _changed("ordered", {"r": np.arange(3.0)}, {"order": [3, 0, 1, 2]})


def _rotations(count: int = 5) -> np.ndarray:
    return rotation.normalise(RNG.normal(size=(count, 4)))


@pytest.mark.parametrize(
    ("turn", "written", "wanted"),
    [
        ("transposed", lambda m: m[:2].ravel(), lambda m: m.T[:2].ravel()),
        ("transposed", lambda m: m.T[:2].ravel(), lambda m: m[:2].ravel()),
        ("interleaved", lambda m: m[:2].ravel(), lambda m: m[:, :2].ravel()),
        ("apart", lambda m: m[:, :2].ravel(), lambda m: m[:2].ravel()),
    ],
    ids=["columns", "rows", "interleaved", "apart"],
)
def test_two_vectors_are_written_otherwise(turn: str, written: Any, wanted: Any) -> None:
    matrices = rotation.to_matrix(_rotations())
    encoded = [{"s": np.concatenate(([0.3, 0.2 * place], written(one), [0.9]))} for place, one in enumerate(matrices)]
    change = turns.RotatedInputs(encoded, {"turn": turn})
    for value, one in zip(encoded, matrices, strict=True):
        assert np.allclose(change(value)["s"][2:8], wanted(one))
        assert (change(value)["s"][[0, 1, 8]] == value["s"][[0, 1, 8]]).all()


@pytest.mark.parametrize(
    ("turn", "wanted"),
    [
        ("last_first", lambda q: np.roll(q, 1)),
        ("first_last", lambda q: np.roll(q, -1)),
        ("positive_first", lambda q: q if q[0] > 0 else -q),
        ("positive_last", lambda q: q if q[3] > 0 else -q),
        ("negative", lambda q: -q),
    ],
)
def test_quaternions_are_written_otherwise(turn: str, wanted: Any) -> None:
    """Two of them in one vector; four numbers that are of length one by chance, once, are none."""
    encoded = [
        np.concatenate(([5.0], one, [2.0, 0.0, 0.0, 1.0, 0.0], other))
        for one, other in zip(_rotations(), _rotations(), strict=True)
    ]
    change = turns.RotatedInputs(encoded, {"turn": turn})
    for value in encoded:
        result = change(value)
        assert np.allclose(result[1:5], wanted(value[1:5]))
        assert np.allclose(result[10:], wanted(value[10:]))
        assert result[5:10].tolist() == value[5:10].tolist()
    with pytest.raises(NoEffectError, match="no such rotation"):
        turns.RotatedInputs([RNG.uniform(2, 3, 8) for _ in range(4)], {"turn": turn})


def test_some_numbers_are_scaled() -> None:
    how = {"width": 5, "places": [1, 4], "scale": 100.0, "offset": -1.0}
    result = _changed("linear", {"a": np.ones((2, 5)), "b": np.ones(6)}, how)
    assert result["a"].tolist() == [[1.0, 99.0, 1.0, 1.0, 99.0]] * 2
    assert result["b"].tolist() == [1.0] * 6
    with pytest.raises(NoEffectError, match="no vector"):
        _changed("linear", np.ones(4), how)


class Small(Policy):
    def load(self, config: Mapping[str, Any]) -> None:
        self.stats = {"low": LOW.tolist(), "high": HIGH}

    def encode(self, obs: Mapping[str, Any], env: int) -> Any:
        state = obs["state"]
        return {
            "state": np.concatenate((state["arm_joint_state"], state["ee_joint_state"])),
            "text": obs["instruction"],
        }

    def predict(self, inputs: list[Any], envs: list[int]) -> Any:
        return [np.tanh(item["state"])[None] * 0.4 + 0.01 * len(item["text"]) for item in inputs]


def test_changes_are_played_one_after_another() -> None:
    model = Small({"env_cfg_type": "franka_single", "action_type": "joint"})
    shown = [{**observation("franka_single", seed), "env_idx": 0} for seed in (1, 2)]
    calls = [{"reset": True}, {"show": [[0, shown[0]]]}, {"ask": [0]}, {"show": [[0, shown[1]]]}, {"ask": [0]}]
    wanted = [
        {"kind": "colours"},
        {"kind": "text", "case": "keep", "strip": ".", "template": "{instruction}!!!"},
        *({"kind": "normalized", "number": number} for number in range(5)),
        {"kind": "ordered", "way": "both", "order": [1, 0, *range(2, 8)]},
        {"kind": "nonsense"},
    ]
    told = [packed.decode(answer) for answer in play.changes(model, wanted, calls, 100.0)]
    assert "it changes nothing" in told[0]["error"]
    assert "unknown change nonsense" in told[-1]["error"]
    plain = np.tanh(np.concatenate((shown[1]["state"]["arm_joint_state"], shown[1]["state"]["ee_joint_state"]))) * 0.4
    assert told[1]["result"]["answers"][1][0]["arm_joint_state"] == pytest.approx(plain[:7] + 0.1, abs=1e-6)
    ordered = told[-2]["result"]["answers"][1][0]["arm_joint_state"]
    assert ordered == pytest.approx(plain[:7] + 0.08, abs=1e-6)  # there and back
    by_words = {answer["result"]["words"]: answer["result"] for answer in told[2:-2] if "result" in answer}
    assert sorted(by_words) == [
        "normalize: LOW to HIGH as -1 to 1, not none",
        "normalize: LOW to HIGH as 0 to 1, not none",
        "normalize: mean LOW, std HIGH, not none",
    ]
    model.update_obs(shown[0])
    (step,) = model.get_action()
    first = np.tanh(shown[0]["state"]["arm_joint_state"]) * 0.4 + 0.08
    assert step["arm_joint_state"] == pytest.approx(first, abs=1e-6)


def test_time_that_is_over_ends_it() -> None:
    model = Small({"env_cfg_type": "franka_single", "action_type": "joint"})
    calls = [{"show": [[0, observation("franka_single")]]}, {"ask": [0]}]
    assert list(play.changes(model, [{"kind": "colours"}], calls, -1.0)) == []
