"""What the commands of one arm are: kind, order, unit, form, and from what they are counted."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl_cli.data.probe import tracking
from xpl_cli.data.probe.answer import MARGIN, HypothesisRanking, ProbeAnswer, is_decisive, unknown
from xpl_cli.data.probe.arms import FORMS, format_form, of_numbers, of_poses, of_scaled, order_of
from xpl_cli.data.probe.parts import ARM, JOINTS, POSITION, ROTATION, THREE, VectorPart

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.data.probe.arms import Reference
    from xpl_cli.data.probe.states import ArmState

_ROWS: Final = 1500
_NO_STATE: Final = "states of the same kind beside the commands"
_DEGREES: Final = np.pi / 180
_TURN: Final = 1.2 * 2 * np.pi
"""More than a turn in radians, with room for numbers that go on beyond it: degrees."""


@dataclass
class CommandPlot:
    """Two lines of one number: where the command leads, and where the robot goes."""

    title: str
    state: np.ndarray
    command: np.ndarray


@dataclass
class CommandAnalysis:
    """What was found out of an arm's commands.

    Attributes:
        answers: the conventions.
        plots: what shows them.
    """

    answers: list[ProbeAnswer] = field(default_factory=list)
    plots: list[CommandPlot] = field(default_factory=list)


def of_arm(parts: Sequence[VectorPart], state: ArmState, *, normalised: bool) -> CommandAnalysis:
    """Return what an arm's commands are.

    Args:
        parts: its commands.
        state: the arm's state.
        normalised: whether commands or states are.
    """
    found = CommandAnalysis()
    joints = next((part for part in parts if part.kind in (JOINTS, ARM)), None)
    place = next((part for part in parts if part.kind in (POSITION, THREE)), None)
    turn = next((part for part in parts if part.kind == ROTATION), None)
    if joints is not None and joints.kind == ARM and _is_pose(joints, state, normalised=normalised):
        place, turn, joints = joints.cut(POSITION, 0, 3), joints.cut(ROTATION, 3, 6), None
    if joints is not None:
        _analyse_joints(found, joints, state, normalised=normalised)
    if place is not None:
        _analyse_pose(found, place, turn, state, normalised=normalised)
    return found


def _cut(rows: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return whole episodes up to a number of rows, the longest of a set's own length."""
    kept, count = [], 0
    for episode in rows:
        if count and count + len(episode) > _ROWS:
            break
        kept.append(episode[:_ROWS])
        count += len(episode)
    return kept


def _is_pose(part: VectorPart, state: ArmState, *, normalised: bool) -> bool:
    """Tell whether six numbers of a command are a pose: where joints explain them less."""
    pose_error = np.inf
    if state.position is not None and state.rotation is not None and not normalised:
        moved, spun = _rank_pose_hypotheses(part.cut(POSITION, 0, 3), part.cut(ROTATION, 3, 6), state)
        pose_error = moved.least + (spun.least if spun.errors else 1.0)
    joint_error = np.inf
    beside = state.joints if state.joints is not None and state.joints.width == part.width else state.unsure
    if beside is not None:
        rows = _cut(beside.rows)
        reference = (of_scaled if normalised else of_numbers)(rows, _cut(part.rows))
        joint_error = 2 * min(reference.errors.values())
    return bool(pose_error < joint_error)


def _analyse_joints(found: CommandAnalysis, part: VectorPart, state: ArmState, *, normalised: bool) -> None:
    """Tell what commands are that are joints, or six numbers of which nobody knows what they are."""
    beside = state.joints if state.joints is not None else state.unsure
    if beside is None or beside.width != part.width:
        why = f"no column of the state has {part.width} numbers of joints"
        found.answers.append(unknown("kind", part.subject, why, _NO_STATE))
        return
    here, there = _cut(beside.rows), _cut(part.rows)
    order, margin = order_of(here, there)
    plain = order == tuple(range(part.width))
    if margin >= MARGIN:
        said = "each number moves its own of the state" if plain else "its numbers move the state's in this order"
        value = "as the state" if plain else list(order)
        found.answers.append(ProbeAnswer("order", part.subject, value, said, margin))
        there = [rows[:, list(order)] for rows in there]
    else:
        why = "several numbers move alike"
        found.answers.append(unknown("order", part.subject, why, "episodes in which each joint moves by itself"))
    if state.joints is not None:
        said = f"they move the joints of {state.joints.subject}"
        found.answers.append(ProbeAnswer("kind", part.subject, JOINTS, said))
    reference = of_scaled(here, there) if normalised else _in_unit(found, part, state, here, there)
    _add_reference(found, part, reference)
    if reference.value is not None and not normalised:
        _add_latency(found, part, here, there, reference)
    found.plots.append(CommandPlot(f"{part.subject}, number {part.start}", here[0][:, 0], there[0][:, 0]))


def _in_unit(
    found: CommandAnalysis, part: VectorPart, state: ArmState, here: list[np.ndarray], there: list[np.ndarray]
) -> Reference:
    """Return from what commands are counted, read in the unit in which they explain the motion; tell that unit."""
    tried = {
        unit: of_numbers([rows * (state.unit or 1.0) for rows in here], [rows * unit for rows in there])
        for unit in (1.0, _DEGREES)
    }
    contest: dict[float, float] = {}
    for unit, one in tried.items():
        error = min(one.errors.values()) if one.value is None else one.errors[one.value]
        contest[unit] = max(error, 1e-4) if _is_gain(one) else 1.0
    best = min(contest, key=lambda unit: contest[unit])
    margin = max(contest.values()) / contest[best]
    known = {1.0: "rad", _DEGREES: "deg"}
    if state.unit is not None and margin >= MARGIN and tried[best].value is not None:
        said = f"so they explain where the joints go, but for {contest[best]:.2g} of the motion"
        found.answers.append(ProbeAnswer("angle unit", part.subject, known[best], said, margin))
    for place, rows in enumerate(there):
        there[place] = rows * (best / (state.unit or 1.0))
    return tried[best]


def _is_gain(reference: Reference) -> bool:
    """Tell whether a robot goes a sensible part of the way in a step: in a wrong unit it goes none, or too much."""
    return 0.02 < reference.follow.gain < 1.6


def _add_reference(found: CommandAnalysis, part: VectorPart, reference: Reference) -> None:
    """Tell from what commands are counted."""
    names = {"absolute": "absolute", "delta_state": "from the state", "delta_command": "from the last command"}
    errors = ", ".join(f"{names[name]} {error:.2g}" for name, error in reference.errors.items())
    if reference.alike:
        why = "each command is reached in its step, so that counting from the state and from the last command is one"
        answer = unknown("reference", part.subject, why, "a robot that lags behind its commands")
    elif reference.value is None:
        why = f"no reading explains where the robot goes (left unexplained: {errors})"
        answer = unknown("reference", part.subject, why, _NO_STATE)
    elif not is_decisive(reference.margin):
        why = f"two readings explain the motion nearly alike (left unexplained: {errors})"
        answer = unknown("reference", part.subject, why, "longer or faster motion")
    else:
        said = f"left unexplained of the motion: {errors}"
        if reference.value == "delta_command":
            said += "; summed over an episode they stay with the state"
        ranked = sorted(reference.errors, key=lambda name: reference.errors[name])
        second = next(name for name in ranked if name != reference.value)
        answer = ProbeAnswer("reference", part.subject, reference.value, said, reference.margin, second)
    found.answers.append(answer)


def _add_latency(
    found: CommandAnalysis, part: VectorPart, here: list[np.ndarray], there: list[np.ndarray], reference: Reference
) -> None:
    """Tell after how many steps commands are reached."""
    if reference.value == "absolute":
        lead = there
    elif reference.value == "delta_state":
        lead = [a + b for a, b in zip(here, there, strict=True)]
    else:
        lead = tracking.cumulated(here, there)
    steps, off = tracking.tracking_delay(here, lead)
    if off > 0.5:
        return
    said = f"the state is nearest to a command {steps:.1f} steps later, {100 * off:.2g} % of the motion off"
    if steps < 0.2 and off < 1e-3:
        said = "commands are a copy of the state of their own step"
    elif abs(steps - 1) < 0.1 and off < 1e-3:
        said = "commands are the state of the next step"
    found.answers.append(ProbeAnswer("latency", part.subject, round(steps, 1), said))


def _rank_pose_hypotheses(
    place: VectorPart, turn: VectorPart | None, state: ArmState
) -> tuple[HypothesisRanking, HypothesisRanking]:
    """Return how well readings of pose commands explain the motion."""
    assert state.position is not None  # noqa: S101 - asked only then
    positions = _cut(state.position.rows)
    turns = {form: _cut(rows) for form, rows in state.turns().items()}
    if not turns:
        still = [np.tile([1.0, 0.0, 0.0, 0.0], (len(rows), 1)) for rows in positions]
        turns = {("none", None): still}
    spins = _cut(turn.rows) if turn is not None else []
    forms = list(FORMS[turn.width]) if turn is not None else []
    known = len(turns) == 1
    if not known and turn is not None:  # of a form that is open those are tried that go together
        forms = [form for form in forms if form[0] == "axis_angle" or form in turns]
    unit = _DEGREES if turn is not None and turn.width == 3 and np.abs(turn.stacked).max() > _TURN else 1.0
    return of_poses(positions, turns, _cut(place.rows), [rows * unit for rows in spins], forms)


def _analyse_pose(
    found: CommandAnalysis, place: VectorPart, turn: VectorPart | None, state: ArmState, *, normalised: bool
) -> None:
    """Tell what commands are that are poses."""
    if state.position is None:
        why = "no column of the state says where the arm is"
        found.answers.append(unknown("kind", place.subject, why, _NO_STATE))
        return
    if normalised:
        here, there = _cut(state.position.rows), _cut(place.rows)
        _add_reference(found, place, of_scaled(here, there))
        return
    moved, spun = _rank_pose_hypotheses(place, turn, state)
    if moved.least <= tracking.PLAIN:
        found.answers.append(ProbeAnswer("kind", place.subject, POSITION, f"they move {state.position.subject}"))
    _add_facets(found, place, moved, ("reference", "applied"))
    value = moved.best["reference"]
    here, there = _cut(state.position.rows), _cut(place.rows)
    if moved.least <= tracking.PLAIN and not (value != "absolute" and moved.best["applied"] == "body"):
        _add_latency(found, place, here, there, of_numbers(here, there))
    if turn is not None and spun.errors:
        if spun.least <= tracking.PLAIN:
            subject = state.rotation.subject if state.rotation is not None else place.subject
            found.answers.append(ProbeAnswer("kind", turn.subject, ROTATION, f"they turn {subject}"))
        _add_facets(found, turn, spun, ("reference", "applied", "form"))
        if len(state.forms) > 1 and state.rotation is not None and spun.least <= tracking.PLAIN:
            form, margin, second = spun.judge("state")
            if margin is not None and margin >= MARGIN:
                said = f"so the commands explain how it turns, but for {spun.least:.2g}"
                answer = ProbeAnswer(
                    "rotation form", state.rotation.subject, format_form(form), said, margin, format_form(second)
                )
                state.answers[:] = [
                    one
                    for one in state.answers
                    if (one.topic, one.subject) != ("rotation form", state.rotation.subject)
                ]
                state.answers.append(answer)
                state.forms = (form,)
    found.plots.append(CommandPlot(f"{place.subject}, number {place.start}", here[0][:, 0], there[0][:, 0]))


def _add_facets(found: CommandAnalysis, part: VectorPart, contest: HypothesisRanking, facets: Sequence[str]) -> None:
    """Tell each facet of the reading that explains most, where it is far enough ahead."""
    for facet in facets:
        topic = {"form": "rotation form"}.get(facet, facet)
        if contest.least > tracking.PLAIN:
            why = f"no reading explains where the robot goes; the best leaves {contest.least:.2g} of the motion"
            found.answers.append(unknown(topic, part.subject, why, _NO_STATE))
            continue
        value, margin, second = contest.judge(facet)
        if facet == "applied" and contest.best["reference"] == "absolute":
            continue
        degrees = facet == "form" and part.width == 3 and np.abs(part.stacked).max() > _TURN
        name, other = (
            format_form(one, degrees=bool(degrees)) if isinstance(one, tuple) else one for one in (value, second)
        )
        if margin is not None and margin >= MARGIN:
            left = _least_error(contest, facet, second)
            said = f"read so, commands leave {contest.least:.2g} of the motion unexplained; {other} leaves {left:.2g}"
            found.answers.append(ProbeAnswer(topic, part.subject, name, said, margin, other))
        elif margin is None:
            found.answers.append(ProbeAnswer(topic, part.subject, name, "there is no other form of so many numbers"))
        else:
            why = f"{name} and {other} explain the motion nearly alike ({contest.least:.2g})"
            found.answers.append(unknown(topic, part.subject, why, "larger turns, or a robot that lags behind"))


def _least_error(contest: HypothesisRanking, facet: str, value: object) -> float:
    return min(error for key, error in contest.errors.items() if dict(key)[facet] == value)
