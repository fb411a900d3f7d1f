"""XPL240: A half turn of the end effector is lost."""

from __future__ import annotations

from collections.abc import Iterator

from xpl.contract import ObservationDict
from xpl.embodiment import get_embodiment
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.rotations import HALF_TURNS, NEARLY, ORDINARY, first_turns, rotation_difference
from xpl_cli.audit.offline.semantics import Semantics, answers_poses
from xpl_cli.audit.served.changed_inputs import turned
from xpl_cli.audit.served.compare import is_answer_list, same, structure_problem
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.recorded_client import Answer

_FOLLOWS, _LOST = 0.1, 0.5
"""An action that stays this near to the observed orientation in an ordinary pose, rad, and goes this far off in a half
turn, has lost it on the way."""
_FIX = Fix("advice", "convert rotations with xpl.rotation, which is exact at half turns")


@rule(code="XPL240", requirement="XPL-ACT-16", profile="full", tries="rotations")
def half_turn_preserved(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """A half turn of the end effector is lost.

    ## What it does
    Sends observations with the end effectors rotated by 180 degrees about several axes. An adapter whose actions are
    near the observed orientation in general must be near it there, none may fail or return the identity rotation, and
    half turns about different axes must give different actions.

    ## Why it matters
    A gripper that points straight down is often a half turn away from the base. If that becomes the identity, the arm
    is commanded to turn it over.

    ## Example
    An axis divided by the sine of the angle, with zeros where the sine is small: it is small at 180 degrees too.

    ## Use instead
    `xpl.rotation.to_axis_angle`, `from_matrix` and `from_axis_angle`.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    probe.require_repeatable()
    if semantics.posed is None:
        raise NotApplicable("neither actions nor required inputs are poses")
    robot, action_type = semantics.posed
    ordinary = turned(semantics.posed_observation(), ORDINARY)
    rotated = {what: turned(ordinary, quaternion) for what, quaternion in (HALF_TURNS | NEARLY).items()}
    pairs = [((ordinary,), (obs,)) for obs in rotated.values()]
    chunks = dict(zip(rotated, semantics.compare(pairs, semantics.posed), strict=True))
    plain = next(iter(chunks.values()))[0]
    embodiment = get_embodiment(robot)
    if structure_problem(plain, embodiment, action_type) is not None:
        raise NotApplicable(f"{action_type} actions for {robot} do not have the form that the embodiment requires")
    for what, (_, chunk) in chunks.items():
        problem = structure_problem(chunk, embodiment, action_type)
        if problem is None and answers_poses(action_type):
            problem = _lost(ordinary, plain, rotated[what], chunk)
        if problem is not None:
            yield blame(
                f"a half turn {what} is lost: the end effector would be turned over",
                expected="an orientation near the observed one" if is_answer_list(chunk) else "an action",
                got=problem,
                fix=_FIX,
            )
            return
    if all(rotation_difference(plain, chunk) is None for _, chunk in chunks.values()):
        raise NotApplicable("the actions do not depend on the orientation of an end effector")
    yield from _confused(plain, {what: chunks[what][1] for what in HALF_TURNS})


def _lost(ordinary: ObservationDict, plain: Answer, obs: ObservationDict, chunk: Answer) -> str | None:
    for before, after in zip(first_turns(ordinary, plain), first_turns(obs, chunk), strict=True):
        if after.is_identity and not before.is_identity:
            return f"{after.key} is commanded to the identity"
        if before.away < _FOLLOWS and after.away > _LOST:
            return (
                f"{after.key} is commanded {after.away:.3g} rad away from the observed orientation; "
                f"in an ordinary pose it is {before.away:.3g} rad"
            )
    return None


def _confused(plain: Answer, about: ObservationDict) -> Iterator[Finding]:
    """Yield two different half turns that are answered alike, unless no orientation matters."""
    names = list(about)
    alike = [
        (one, other)
        for index, one in enumerate(names)
        for other in names[index + 1 :]
        if rotation_difference(about[one], about[other]) is None
    ]
    if alike and not all(same(plain, chunk) for chunk in about.values()):
        one, other = alike[0]
        yield blame(
            f"half turns {one} and {other} give the same action: the rotation is lost in both",
            expected="another action for another orientation",
            got="the same action",
            fix=_FIX,
        )
