"""XPL202: Actions lack keys, dimensions or finite values that the embodiment requires."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.offline.motion import MotionAnswer, MotionEpisode, MotionEpisodes
from xpl_cli.audit.rules.profiles import ServedProfile
from xpl_cli.audit.served.compare import shapes, structure_problem
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL202", requirement="XPL-ACT-1", tries="shapes of actions")
def action_structure(motions: MotionEpisodes, profile: ServedProfile, probe: Probe) -> Iterator[Finding]:
    """Actions lack keys, dimensions or finite values that the embodiment requires.

    ## What it does
    Serves the adapter for every embodiment and action type that its manifest declares, runs three steps of an episode
    with each action executed, then requests a batch of two environments, and checks each action step: exact keys,
    dimensions, finite values, unit quaternions, grippers between 0 and 1. In shadow mode, an answer that is no list is
    a warning unless policy.yml declares the `shape` of `shadow`: the mock's output may have other axes.

    ## Why it matters
    A robot with other dimensions gets truncated or shifted commands; a controller that gets a NaN stops or, worse,
    continues.

    ## Example
    `actions[:, :6]` on an arm with 7 joints, or `left_arm_joint_state` for a robot with one arm.

    ## Use instead
    `self.embodiment.dims(self.action_type)` for the keys and their dimensions, `xpl.action.unpack` for the split.

    ## Fix safety
    No automatic fix.
    """
    alike: dict[str, list[tuple[MotionEpisode, MotionAnswer]]] = {}
    for motion in motions.all:
        wrong = next(((answer, error) for answer in motion.answers if (error := motion.problem(answer))), None)
        if wrong is not None:
            answer, problem = wrong
            alike.setdefault(problem, []).append((motion, answer))
    for problem, ((motion, answer), *others) in alike.items():
        too = [f"{other.action_type} for {other.embodiment.name}" for other, _ in others]
        dims = motion.embodiment.dims(motion.action_type)
        is_of_mock = _is_of_mock(answer, profile, probe)
        is_of_random = motions.is_random and _RANGE in problem
        why = ", which may come from the mock in place of the model: declare the shape of its output as `shadow`"
        yield blame(
            f"{motion.action_type} actions for {motion.embodiment.name} cannot be executed: {problem}"
            + (why if is_of_mock else "")
            + (", which random weights may cause" if is_of_random else "")
            + (f"; likewise {', '.join(too)}" if too else ""),
            expected=", ".join(f"{key} ({dim},)" for key, dim in dims.items()),
            got=f"{answer.where}: {shapes(answer.chunk)}",
            fix=Fix(
                "advice",
                "return flat rows of the embodiment's dimension from predict and let the base class unpack them",
            ),
            must=False if is_of_mock or is_of_random else None,
        )


_RANGE = "must lie between"
"""In what `xpl.action` says of a number that is out of its range."""


def _is_of_mock(answer: MotionAnswer, profile: ServedProfile, probe: Probe) -> bool:
    """Tell whether an answer that is no list may be one only because a mock of undeclared shape ran."""
    if not profile.is_shadow or probe.package.manifest.shadow.shape:
        return False
    return "must be a list of action steps" in (
        structure_problem(answer.chunk, probe.embodiment, probe.action_type) or ""
    )
