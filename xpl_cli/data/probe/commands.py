"""Analysis of the commands of one arm: kind, order, unit, rotation form and reference."""

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
"""A little more than a full turn in radians; larger numbers are degrees."""


@dataclass
class CommandPlot:
    """State and command of one number over time."""

    title: str
    state: np.ndarray
    command: np.ndarray


@dataclass
class CommandAnalysis:
    """The analysis of an arm's commands.

    Attributes:
        answers: the conventions.
        plots: commands and states to compare.
    """

    answers: list[ProbeAnswer] = field(default_factory=list)
    plots: list[CommandPlot] = field(default_factory=list)


def of_arm(parts: Sequence[VectorPart], state: ArmState, *, normalised: bool) -> CommandAnalysis:
    """Analyse an arm's commands.

    Args:
        parts: its commands.
        state: the arm's state.
        normalised: whether commands or states are normalised.
    """
    analysis = CommandAnalysis()
    joints = next((part for part in parts if part.kind in (JOINTS, ARM)), None)
    position = next((part for part in parts if part.kind in (POSITION, THREE)), None)
    rotation = next((part for part in parts if part.kind == ROTATION), None)
    if joints is not None and joints.kind == ARM and _is_pose(joints, state, normalised=normalised):
        position, rotation, joints = joints.cut(POSITION, 0, 3), joints.cut(ROTATION, 3, 6), None
    if joints is not None:
        _analyse_joints(analysis, joints, state, normalised=normalised)
    if position is not None:
        _analyse_pose(analysis, position, rotation, state, normalised=normalised)
    return analysis


def _cut(rows: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the first episodes, up to 1,500 rows in all."""
    episodes, count = [], 0
    for episode in rows:
        if count and count + len(episode) > _ROWS:
            break
        episodes.append(episode[:_ROWS])
        count += len(episode)
    return episodes


def _is_pose(part: VectorPart, state: ArmState, *, normalised: bool) -> bool:
    """Tell whether six numbers of a command are a pose rather than joints, by the lower error."""
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


def _analyse_joints(analysis: CommandAnalysis, part: VectorPart, state: ArmState, *, normalised: bool) -> None:
    """Analyse commands that are joints, or six numbers of unknown kind."""
    beside = state.joints if state.joints is not None else state.unsure
    if beside is None or beside.width != part.width:
        why = f"no column of the state has {part.width} numbers of joints"
        analysis.answers.append(unknown("kind", part.subject, why, _NO_STATE))
        return
    here, there = _cut(beside.rows), _cut(part.rows)
    order, margin = order_of(here, there)
    plain = order == tuple(range(part.width))
    if margin >= MARGIN:
        evidence = "each number moves its own of the state" if plain else "its numbers move the state's in this order"
        value = "as the state" if plain else list(order)
        analysis.answers.append(ProbeAnswer("order", part.subject, value, evidence, margin))
        there = [rows[:, list(order)] for rows in there]
    else:
        why = "several numbers move in the same way"
        analysis.answers.append(unknown("order", part.subject, why, "episodes in which each joint moves by itself"))
    if state.joints is not None:
        evidence = f"they move the joints of {state.joints.subject}"
        analysis.answers.append(ProbeAnswer("kind", part.subject, JOINTS, evidence))
    reference = of_scaled(here, there) if normalised else _in_unit(analysis, part, state, here, there)
    _add_reference(analysis, part, reference)
    if reference.value is not None and not normalised:
        _add_latency(analysis, part, here, there, reference)
    analysis.plots.append(CommandPlot(f"{part.subject}, number {part.start}", here[0][:, 0], there[0][:, 0]))


def _in_unit(
    analysis: CommandAnalysis, part: VectorPart, state: ArmState, here: list[np.ndarray], there: list[np.ndarray]
) -> Reference:
    """Return the reference of commands in the angle unit that explains the motion best; add an answer for the unit."""
    references = {
        unit: of_numbers([rows * (state.unit or 1.0) for rows in here], [rows * unit for rows in there])
        for unit in (1.0, _DEGREES)
    }
    errors: dict[float, float] = {}
    for unit, one in references.items():
        error = min(one.errors.values()) if one.value is None else one.errors[one.value]
        errors[unit] = max(error, 1e-4) if _is_gain(one) else 1.0
    best = min(errors, key=lambda unit: errors[unit])
    margin = max(errors.values()) / errors[best]
    unit_names = {1.0: "rad", _DEGREES: "deg"}
    if state.unit is not None and margin >= MARGIN and references[best].value is not None:
        evidence = f"so they explain where the joints go, but for {errors[best]:.2g} of the motion"
        analysis.answers.append(ProbeAnswer("angle unit", part.subject, unit_names[best], evidence, margin))
    for index, rows in enumerate(there):
        there[index] = rows * (best / (state.unit or 1.0))
    return references[best]


def _is_gain(reference: Reference) -> bool:
    """Tell whether the gain is plausible: in a wrong unit it is near 0, or too large."""
    return 0.02 < reference.follow.gain < 1.6


def _add_reference(analysis: CommandAnalysis, part: VectorPart, reference: Reference) -> None:
    """Add the answer for the reference of commands."""
    names = {"absolute": "absolute", "delta_state": "from the state", "delta_command": "from the last command"}
    errors = ", ".join(f"{names[name]} {error:.2g}" for name, error in reference.errors.items())
    if reference.alike:
        why = "each command is reached in its step, so deltas to the state and to the last command are the same"
        answer = unknown("reference", part.subject, why, "a robot that lags behind its commands")
    elif reference.value is None:
        why = f"no reference explains where the robot goes (unexplained share: {errors})"
        answer = unknown("reference", part.subject, why, _NO_STATE)
    elif not is_decisive(reference.margin):
        why = f"two references explain the motion nearly equally well (unexplained share: {errors})"
        answer = unknown("reference", part.subject, why, "longer or faster motion")
    else:
        evidence = f"unexplained share of the motion: {errors}"
        if reference.value == "delta_command":
            evidence += "; summed over an episode they follow the state"
        ranked = sorted(reference.errors, key=lambda name: reference.errors[name])
        second = next(name for name in ranked if name != reference.value)
        answer = ProbeAnswer("reference", part.subject, reference.value, evidence, reference.margin, second)
    analysis.answers.append(answer)


def _add_latency(
    analysis: CommandAnalysis, part: VectorPart, here: list[np.ndarray], there: list[np.ndarray], reference: Reference
) -> None:
    """Add the answer for the latency: after how many steps commands are reached."""
    if reference.value == "absolute":
        lead = there
    elif reference.value == "delta_state":
        lead = [a + b for a, b in zip(here, there, strict=True)]
    else:
        lead = tracking.cumulated(here, there)
    steps, off = tracking.tracking_delay(here, lead)
    if off > 0.5:
        return
    evidence = f"the state is nearest to a command {steps:.1f} steps later, {100 * off:.2g} % of the motion off"
    if steps < 0.2 and off < 1e-3:
        evidence = "commands are a copy of the state of their own step"
    elif abs(steps - 1) < 0.1 and off < 1e-3:
        evidence = "commands are the state of the next step"
    analysis.answers.append(ProbeAnswer("latency", part.subject, round(steps, 1), evidence))


def _rank_pose_hypotheses(
    position: VectorPart, rotation: VectorPart | None, state: ArmState
) -> tuple[HypothesisRanking, HypothesisRanking]:
    """Rank the hypotheses on pose commands by how well they explain the motion."""
    assert state.position is not None  # noqa: S101 - asked only then
    positions = _cut(state.position.rows)
    turns = {form: _cut(rows) for form, rows in state.turns().items()}
    if not turns:
        still = [np.tile([1.0, 0.0, 0.0, 0.0], (len(rows), 1)) for rows in positions]
        turns = {("none", None): still}
    spins = _cut(rotation.rows) if rotation is not None else []
    forms = list(FORMS[rotation.width]) if rotation is not None else []
    is_form_known = len(turns) == 1
    if not is_form_known and rotation is not None:  # while the state's form is unknown, try the same form for both
        forms = [form for form in forms if form[0] == "axis_angle" or form in turns]
    unit = _DEGREES if rotation is not None and rotation.width == 3 and np.abs(rotation.stacked).max() > _TURN else 1.0
    return of_poses(positions, turns, _cut(position.rows), [rows * unit for rows in spins], forms)


def _analyse_pose(
    analysis: CommandAnalysis, position: VectorPart, rotation: VectorPart | None, state: ArmState, *, normalised: bool
) -> None:
    """Analyse commands that are poses."""
    if state.position is None:
        why = "no column of the state says where the arm is"
        analysis.answers.append(unknown("kind", position.subject, why, _NO_STATE))
        return
    if normalised:
        here, there = _cut(state.position.rows), _cut(position.rows)
        _add_reference(analysis, position, of_scaled(here, there))
        return
    moved, spun = _rank_pose_hypotheses(position, rotation, state)
    if moved.least <= tracking.PLAIN:
        analysis.answers.append(ProbeAnswer("kind", position.subject, POSITION, f"they move {state.position.subject}"))
    _add_facets(analysis, position, moved, ("reference", "applied"))
    value = moved.best["reference"]
    here, there = _cut(state.position.rows), _cut(position.rows)
    if moved.least <= tracking.PLAIN and not (value != "absolute" and moved.best["applied"] == "body"):
        _add_latency(analysis, position, here, there, of_numbers(here, there))
    if rotation is not None and spun.errors:
        if spun.least <= tracking.PLAIN:
            subject = state.rotation.subject if state.rotation is not None else position.subject
            analysis.answers.append(ProbeAnswer("kind", rotation.subject, ROTATION, f"they turn {subject}"))
        _add_facets(analysis, rotation, spun, ("reference", "applied", "form"))
        if len(state.forms) > 1 and state.rotation is not None and spun.least <= tracking.PLAIN:
            form, margin, second = spun.judge("state")
            if margin is not None and margin >= MARGIN:
                evidence = f"so the commands explain how it turns, but for {spun.least:.2g}"
                answer = ProbeAnswer(
                    "rotation form", state.rotation.subject, format_form(form), evidence, margin, format_form(second)
                )
                state.answers[:] = [
                    one
                    for one in state.answers
                    if (one.topic, one.subject) != ("rotation form", state.rotation.subject)
                ]
                state.answers.append(answer)
                state.forms = (form,)
    analysis.plots.append(CommandPlot(f"{position.subject}, number {position.start}", here[0][:, 0], there[0][:, 0]))


def _add_facets(analysis: CommandAnalysis, part: VectorPart, ranking: HypothesisRanking, facets: Sequence[str]) -> None:
    """Add an answer for each facet of the best hypothesis, unknown where its margin is too small."""
    for facet in facets:
        topic = {"form": "rotation form"}.get(facet, facet)
        if ranking.least > tracking.PLAIN:
            why = f"no hypothesis explains where the robot goes; the best leaves {ranking.least:.2g} of the motion"
            analysis.answers.append(unknown(topic, part.subject, why, _NO_STATE))
            continue
        value, margin, second = ranking.judge(facet)
        if facet == "applied" and ranking.best["reference"] == "absolute":
            continue
        degrees = facet == "form" and part.width == 3 and np.abs(part.stacked).max() > _TURN
        name, other = (
            format_form(one, degrees=bool(degrees)) if isinstance(one, tuple) else one for one in (value, second)
        )
        if margin is not None and margin >= MARGIN:
            left = _least_error(ranking, facet, second)
            evidence = (
                f"read so, commands leave {ranking.least:.2g} of the motion unexplained; {other} leaves {left:.2g}"
            )
            analysis.answers.append(ProbeAnswer(topic, part.subject, name, evidence, margin, other))
        elif margin is None:
            analysis.answers.append(ProbeAnswer(topic, part.subject, name, "there is no other form of this width"))
        else:
            why = f"{name} and {other} explain the motion nearly equally well ({ranking.least:.2g})"
            analysis.answers.append(unknown(topic, part.subject, why, "larger turns, or a robot that lags behind"))


def _least_error(ranking: HypothesisRanking, facet: str, value: object) -> float:
    return min(error for key, error in ranking.errors.items() if dict(key)[facet] == value)
