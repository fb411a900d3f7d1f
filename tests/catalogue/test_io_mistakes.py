"""Changes around an adapter: there and back, each with an effect, and each planted mistake undone by one."""

from __future__ import annotations

import hashlib
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.adapters.model_io import fields as state_of
from xpl.catalogue import AdapterCase, deltas, fields
from xpl.catalogue.convention import io_mistakes
from xpl.embodiment import get_embodiment
from xpl.wire import packed
from xpl_cli.model_io.difference import differences, spreads
from xpl_cli.model_io.script import ScriptedScene
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Callable

    from xpl.catalogue import Mistake

VOCABULARY = {option["const"] for option in spec.schema("model_io")["$defs"]["convention"]["oneOf"]}
CAMERAS = ("cam_head", "cam_left_wrist", "cam_right_wrist")
FEW = settings(max_examples=25, derandomize=True, deadline=None)
ROBOTS = ("franka", "piper_single", "tianji_marvin_wuji")


def _changes(robot: str) -> list[fields.FieldChange]:
    """Return the changes of fields that mistakes are made of, in the order in which they are."""
    seen: list[fields.FieldChange] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fields, "field_mistakes", lambda change, *_: seen.append(change) or ())
        list(io_mistakes(AdapterCase(get_embodiment(robot), "joint", cameras=CAMERAS)))
    return [one for one in seen if "wrist cameras" not in one.description]


@cache
def _signals(robot: str = "franka", action_type: str = "joint", **more: Any) -> tuple[Mistake, ...]:
    """Return all signals around an adapter; they keep nothing, and finding them is what takes the time here."""
    told: dict[str, Any] = {"cameras": CAMERAS, "history": 3, "instructions": ("Do it.", "Leave it."), **more}
    return tuple(io_mistakes(AdapterCase(get_embodiment(robot), action_type, **told)))


def _episode(robot: str = "franka", count: int = 4) -> list[dict[str, Any]]:
    scene = ScriptedScene(get_embodiment(robot), dict.fromkeys(CAMERAS, (24, 32)))
    return [scene.observation(0, place) for place in range(count)]


def _answers(robot: str, action_type: str, count: int = 3, seed: int = 0) -> list[list[dict[str, np.ndarray]]]:
    rng = np.random.default_rng(seed)
    wanted = get_embodiment(robot).dims(action_type)
    made = [[state_of(robot, rng, joints=True) for _ in range(5)] for _ in range(count)]
    return [[{key: step[key] for key in wanted} for step in chunk] for chunk in made]


@FEW
@given(st.sampled_from(ROBOTS), st.integers(0, 10_000), st.data())
def test_changes_go_there_and_back(robot: str, seed: int, data: st.DataObject) -> None:
    """Whatever joints, openings and poses are; an opening that may have been clipped is not known.

    Angles that are read as others of the same rotation come back as the same rotation only within their ranges.
    """
    found = [
        one
        for one in _changes(robot)
        if "action" in one.targets and "euler" not in one.description and "the angle" not in one.description
    ]
    change = data.draw(st.sampled_from(found))
    state = state_of(robot, np.random.default_rng(seed), joints=True)
    for one, other in ((change.to_model, change.to_standard), (change.to_standard, change.to_model)):
        for key, value in other(one(state)).items():
            close = (
                np.isclose(value, state[key], atol=1e-9) | np.isclose(value, -state[key], atol=1e-9) | np.isnan(value)
            )
            clipped = np.isin(one(state)[key], (0.0, 1.0)) & key.endswith("ee_joint_state")
            assert (close | clipped).all(), (change.description, key)


def test_involutions_are_their_own_inverses() -> None:
    episode = _episode()
    twice = [
        one for one in _signals() if one.change_observations is not None and not one.change_actions and not one.windowed
    ]
    twice = [
        one
        for one in twice
        if any(word in one.description for word in ("exchanged", "mirror", "rotate: 180", "transposed"))
    ]
    assert len({one.convention for one in twice}) >= 4
    for signal in twice:
        if "metres" in signal.description or "instead" in signal.description:
            continue
        assert signal.change_observations is not None
        again = signal.change_observations(signal.change_observations(episode))
        for obs, was in zip(again, episode, strict=True):
            for key, value in was["state"].items():
                assert np.allclose(obs["state"][key], value, atol=1e-6), signal.description
            for camera in CAMERAS:
                assert (obs["vision"][camera]["color"] == was["vision"][camera]["color"]).all(), signal.description


@pytest.mark.slow
@pytest.mark.sampled(1)
@pytest.mark.parametrize(("robot", "action_type"), [("franka", "joint"), ("piper_single", "ee")])
def test_each_changes_something(robot: str, action_type: str) -> None:
    episode, answers = _episode(robot), _answers(robot, action_type)
    before = _digest(episode), _digest(answers)
    span = spreads(answers)
    asked = [0, 2, 3]
    for signal in _signals(robot, action_type):
        assert signal.convention in VOCABULARY
        moved = False
        if signal.change_observations is not None:
            shown = signal.change_observations(episode)
            assert signal.windowed or len(shown) == len(episode)
            moved = _digest(shown) != before[0]
        if signal.change_actions is not None:
            changed = signal.change_actions(answers, episode, asked)
            assert [len(chunk) for chunk in changed] == [len(chunk) for chunk in answers]
            moved = moved or max(differences(answers, changed, span).values()) > 0 or changed != answers
        assert moved or signal.convention == "instruction", signal.description  # which may be so already
    assert (_digest(episode), _digest(answers)) == before


def _digest(value: Any) -> str:
    return hashlib.sha256(b"".join(bytes(piece) for piece in packed.encode(value))).hexdigest()


def test_the_likeliest_come_first_and_those_without_a_play_before_others() -> None:
    found = _signals()
    ranks = [(one.rank, one.change_observations is not None, one.windowed) for one in found]
    assert ranks == sorted(ranks)
    words = [one.description for one in found]
    assert words.index("gripper: closed and open exchanged") < words.index("gripper: closed 0, open 255")


def test_only_what_is_read_is_shown_otherwise() -> None:
    found = _signals(cameras=(), instructions=(), history=1, reads=("arm_joint_state", "ee_joint_state"))
    shown = {one.convention for one in found if one.change_observations is not None}
    assert shown == {"joint_order", "angle_unit", "gripper"}
    assert not any(one.windowed for one in found)


# -- mistakes of hand, undone ------------------------------------------------------------------------------------------


def _undone(
    state: Callable[[Any], Any], command: Callable[[Any, Any], Any], right: Callable[[Any, Any], Any]
) -> set[str]:
    """Return the conventions of the signals that undo a mistake.

    Args:
        state: what the adapter shows its model of a state (left joints and gripper).
        command: the command that the adapter makes of the model's answer and the state.
        right: the command that the right adapter makes of the state.
    """
    episode = _episode()
    asked = list(range(len(episode)))

    def seen(obs: Any) -> Any:
        return state(obs["state"])

    def answered(obs: Any) -> list[dict[str, Any]]:
        return [command(np.sin(seen(obs) + step), obs["state"]) for step in range(3)]

    model_io = [[right(obs["state"], step) for step in range(3)] for obs in episode]
    span = spreads(model_io)
    found = set()
    for signal in _signals(history=1, cameras=(), instructions=()):
        shown = episode if signal.change_observations is None else signal.change_observations(episode)
        answers: Any = [answered(obs) for obs in shown]
        if signal.change_actions is not None:
            answers = signal.change_actions(answers, episode, asked)
        if max(differences(model_io, answers, span).values()) < 1e-5:
            found.add(signal.description)
    return found


def _joints(state: Any) -> Any:
    return np.asarray(state["left_arm_joint_state"], np.float64)


def _said(joints: Any) -> dict[str, Any]:
    return {"left_arm_joint_state": joints}


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("state", "command", "right", "words"),
    [
        # The model wants degrees and answers degrees; the adapter leaves both as they are.
        (
            _joints,
            lambda a, s: _said(a),
            lambda s, t: _said(np.deg2rad(np.sin(np.rad2deg(_joints(s)) + t))),
            "unit: deg",
        ),
        # Deltas in degrees, taken for radians.
        (
            lambda s: np.rad2deg(_joints(s)),
            lambda a, s: _said(_joints(s) + a),
            lambda s, t: _said(_joints(s) + np.deg2rad(np.sin(np.rad2deg(_joints(s)) + t))),
            "unit: deg (action)",
        ),
        # The order of joints forgotten on the way in, where the answer is a delta in the standard's order.
        (
            _joints,
            lambda a, s: _said(_joints(s) + a),
            lambda s, t: _said(_joints(s) + np.sin(_joints(s)[::-1] + t)),
            "joint order: reversed (state)",
        ),
        # The order of joints forgotten both ways, with deltas.
        (
            _joints,
            lambda a, s: _said(_joints(s) + a),
            lambda s, t: _said(_joints(s) + np.sin(_joints(s)[::-1] + t)[::-1]),
            "joint order: reversed",
        ),
        # The state added once too often, and not at all.
        (
            _joints,
            lambda a, s: _said(2 * _joints(s) + a),
            lambda s, t: _said(_joints(s) + np.sin(_joints(s) + t)),
            "reference: the state added once less",
        ),
        (
            _joints,
            lambda a, s: _said(a),
            lambda s, t: _said(_joints(s) + np.sin(_joints(s) + t)),
            "reference: delta_state, not absolute",
        ),
        # The other arm on the way in.
        (
            lambda s: np.asarray(s["right_arm_joint_state"], np.float64),
            lambda a, s: _said(_joints(s) + a),
            lambda s, t: _said(_joints(s) + np.sin(_joints(s) + t)),
            "joints: left and right exchanged (state)",
        ),
    ],
)
def test_a_mistake_of_hand_is_undone(state: Any, command: Any, right: Any, words: str) -> None:
    assert words in _undone(state, command, right)


def test_numbers_that_were_added_up_are_steps_that_were() -> None:
    (signal, *_) = [one for one in _signals() if "not over the numbers" in one.description]
    episode, changes = _episode(), np.random.default_rng(1).normal(size=(5, 7)) * 0.1
    start = _joints(episode[2]["state"])
    rest = _answers("franka", "joint", 1)[0]

    def told(axis: int) -> list[dict[str, Any]]:
        rows = start + np.cumsum(changes, axis=axis)
        return [{**step, "left_arm_joint_state": row} for step, row in zip(rest, rows, strict=True)]

    assert signal.change_actions is not None
    ((*made,),) = signal.change_actions([told(1)], episode, [2])
    for step, wanted in zip(made, told(0), strict=True):
        assert step is not None
        assert np.allclose(step["left_arm_joint_state"], wanted["left_arm_joint_state"])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("action_type", ["joint", "ee"])
def test_the_other_arms_state_is_exchanged_for_the_own(action_type: str) -> None:
    signals = [one for one in _signals(action_type=action_type) if "the left arm's own state" in one.description]
    episode = _episode()
    state = episode[1]["state"]
    key = "left_arm_joint_state" if action_type == "joint" else "left_ee_pose"
    (answers,) = _answers("franka", action_type, 1)
    for signal, mode in zip(signals, deltas.FRAMES, strict=False):
        wrong = {key: state[key.replace("left", "right")]}
        given = [
            {**step, **deltas.apply_differences(deltas.differences({key: step[key]}, state, mode), wrong, mode)}
            for step in answers
        ]
        assert signal.change_actions is not None
        (made,) = signal.change_actions([given], episode, [1])
        span = spreads([answers])
        assert max(differences([answers], [made], span).values()) < 1e-6


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("words", "model", "adapter"),
    [
        ("history: the other order in time", lambda seen: seen[-3:], lambda seen: seen[-3:][::-1]),
        ("history: the newest shown once more", lambda seen: seen[-3:], lambda seen: seen[-4:-1]),
        (
            "history: the oldest and the newest exchanged",
            lambda seen: seen[-3:],
            lambda seen: [seen[-1], seen[-2], seen[-3]],
        ),
    ],
)
def test_histories_are_put_right(words: str, model: Any, adapter: Any) -> None:
    (signal, *_) = [one for one in _signals() if one.description == words]
    episode = _episode(count=5)

    def numbers(shown: Any) -> list[float]:
        return [obs["state"]["left_arm_joint_state"][0] for obs in [*[shown[0]] * 4, *shown]]

    assert signal.change_observations is not None
    assert signal.windowed
    for now in range(3, 6):
        assert adapter(numbers(signal.change_observations(episode[:now]))) == model(numbers(episode[:now]))


def test_a_stride_is_put_right() -> None:
    (signal, *_) = [one for one in _signals() if one.description == "history: stride 2"]
    assert signal.change_observations is not None
    shown = signal.change_observations(_episode(count=7))
    assert [obs["additional_info"] for obs in shown[-3:]]
    values = [obs["state"]["left_arm_joint_state"][0] for obs in _episode(count=7)]
    assert [obs["state"]["left_arm_joint_state"][0] for obs in shown[-3:]] == [values[2], values[4], values[6]]
