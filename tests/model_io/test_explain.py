"""Which change explains a difference: wholly, as well as another, in part, or not at all."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from xpl_cli.model_io.explain import Explanation, TriedChange, explain

if TYPE_CHECKING:
    from collections.abc import Mapping

BEFORE = {"arm_joint_state[0]": 0.4, "arm_joint_state[1]": 0.2, "ee_joint_state[0]": 0.9, "ee_joint_state[1]": 0.0}
FINE = 1e-4


def _tried(words: str, convention: str = "gripper", **left: float) -> TriedChange:
    keys = {"a": "arm_joint_state[0]", "b": "arm_joint_state[1]", "c": "ee_joint_state[0]", "d": "ee_joint_state[1]"}
    return TriedChange(words, convention, {**BEFORE, **{keys[name]: value for name, value in left.items()}})


def _explained(*tried: TriedChange, before: Mapping[str, float] = BEFORE) -> Explanation:
    return explain(before, tried, FINE)


def test_a_change_that_leaves_nothing_is_the_cause() -> None:
    explanation = _explained(_tried("worse", c=2.0), _tried("right", "camera", a=1e-7, b=0.0, c=2e-8))
    assert explanation.cause is not None
    assert (explanation.cause.words, explanation.cause.convention) == ("right", "camera")
    assert explanation.parts == ("ee_joint_state[0]", "arm_joint_state[0]", "arm_joint_state[1]")
    assert explanation.best is explanation.cause


def test_two_changes_are_told_together() -> None:
    both = TriedChange("channels: bgr", "image_channels", dict.fromkeys(BEFORE, 0.0), ("unit: deg", "angle_unit"))
    explanation = _explained(_tried("worse", c=2.0), both)
    assert explanation.cause is not None
    assert explanation.cause.conventions == ("image_channels", "angle_unit")
    assert explanation.text.startswith("with `channels: bgr` and `unit: deg` the difference falls from 0.9 to 0")


@pytest.mark.parametrize(("rest", "is_near"), [(0.008, True), (0.02, False)])
def test_a_fall_by_a_hundred_is_consistent_and_no_cause(rest: float, is_near: bool) -> None:
    """Another library's filter never leaves nothing."""
    explanation = _explained(_tried("nearly", a=rest, b=rest, c=rest))
    assert explanation.cause is None
    assert (explanation.near is not None) == is_near
    if explanation.near is not None:
        assert explanation.near.left == tuple(BEFORE)[:3]
        assert explanation.text.startswith("consistent with `nearly`")


def test_changes_with_the_same_effect_are_ties() -> None:
    right = {"a": 0.0, "b": 0.0, "c": 0.0}
    explanation = _explained(
        _tried("one", **right),
        _tried("one", **right),
        _tried("other", **right),
        _tried("third", **{**right, "a": 9e-5}),
    )
    assert explanation.cause is not None
    assert (explanation.cause.words, [tie.words for tie in explanation.ties]) == ("one", ["other"])


def test_parts_are_explained_by_themselves() -> None:
    explanation = _explained(_tried("arm", a=0.0, b=0.0), _tried("hand", c=1e-6), _tried("bad", c=0.0, a=0.8))
    assert explanation.cause is None
    assert [(one.words, one.parts) for one in explanation.partial] == [
        ("arm", ("arm_joint_state[0]", "arm_joint_state[1]")),
        ("hand", ("ee_joint_state[0]",)),
    ]


def test_small_parts_that_fall_explain_nothing() -> None:
    before = {**BEFORE, "ee_joint_state[1]": 0.001}
    tried = TriedChange("chance", "camera", {**before, "ee_joint_state[1]": 0.0})
    assert _explained(tried, before=before).text == ""


def test_a_change_that_lowers_more_than_all_others_is_told() -> None:
    best = _tried("crop", "image_size", a=0.1, b=0.1, c=0.1)
    explanation = _explained(_tried("mirror", "image_orientation", c=0.7), best)
    assert explanation.reducing is not None
    assert explanation.reducing.words == "crop"
    rival = _tried("filter", "image_filter", a=0.12, b=0.1, c=0.1)
    assert _explained(best, rival).text == ""


def test_nothing_is_told_where_nothing_explains() -> None:
    assert _explained(_tried("no", c=0.8), TriedChange("broken", "chunk", {"arm_joint_state[0]": 0.0})).text == ""
    assert _explained(_tried("fine", a=0.0), before=dict.fromkeys(BEFORE, 1e-5)) == Explanation(1e-5, ())
