"""XPL238: Joint commands exceed the limits of the embodiment."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl.embodiment import Embodiment
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.limits import Excess, farthest, outside
from xpl_cli.audit.offline.motion import MotionAnswer, MotionEpisodes
from xpl_cli.audit.served.probe import blame


@rule(code="XPL238", requirement="XPL-ACT-9", profile="full", tries="limits and step sizes")
def joint_limits(motions: MotionEpisodes) -> Iterator[Finding]:
    """Joint commands exceed the limits of the embodiment.

    ## What it does
    Checks the joint commands of a short episode, with every embodiment whose limits are known. The observed joints are
    well inside them. Then sends joints near their limits: there a command may exceed a limit by as much as the policy
    moves a joint elsewhere, because an environment clamps that; more is no motion but a wrong scale.

    ## Why it matters
    An environment clamps what it cannot execute, so the robot's motion differs from the policy's; a controller on
    hardware may stop with a fault instead.

    ## Example
    Commands in degrees, or rescaled with the statistics of another robot.

    ## Use instead
    `self.embodiment.arms[0].lower` and `upper`, to keep a model's output inside.

    ## Fix safety
    No automatic fix.
    """
    limited = [
        motion
        for motion in motions.sound
        if spec.ACTION_KEYS[motion.action_type][0] == spec.State.ARM_JOINT_STATE
        and any(arm.lower is not None for arm in motion.embodiment.arms)
    ]
    if not limited:
        raise NotApplicable("no joint command for a robot whose limits are known")
    for motion in limited:
        robot = motion.embodiment
        begun = [answer for answer in motion.sound if not answer.step]  # what goes on from there may have added up
        moves = max((farthest(robot, answer.obs[spec.Obs.STATE], answer.chunk) for answer in begun), default=0.0)
        within = list(_past(robot, motion.sound, 0.0))
        excesses = within or list(_past(robot, motion.sound_near_limits, moves))
        if excesses:
            motions.require_trained()
            answer, index, excess = max(excesses, key=lambda entry: abs(entry[2].value - entry[2].limit))
            joints = ", ".join(dict.fromkeys(excess.what for _, _, excess in excesses))
            near = "" if within else " where they are near them"
            yield blame(
                f"joints of {robot.name} are commanded beyond their limits{near} ({joints}): the robot would "
                "stop, or its motion would differ from the policy's",
                expected=f"{excess.what} up to {excess.limit:.4g} rad"
                + (f", or beyond it by the {moves:.2g} rad that the policy moves elsewhere" if near else ""),
                got=f"{excess.value:.4g} rad ({answer.where}, action {index} of the chunk)",
                fix=Fix("advice", "check units and statistics, and keep the output inside the limits in decode"),
            )


def _past(
    robot: Embodiment, answered: list[MotionAnswer], allowed: float
) -> Iterator[tuple[MotionAnswer, int, Excess]]:
    for answer in answered:
        for index, action in enumerate(answer.chunk):
            for excess in outside(robot, action, allowed):
                yield answer, index, excess
