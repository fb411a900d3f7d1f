"""XPL237: The first action of an episode is far from where the robot is."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.offline.limits import jumps
from xpl_cli.audit.offline.motion import Motions
from xpl_cli.audit.served.probe import blame


@rule(code="XPL237", requirement="XPL-ACT-8", profile="full")
def first_action_near(motions: Motions) -> Iterator[Finding]:
    """The first action of an episode is far from where the robot is.

    ## What it does
    With every embodiment and action type that the manifest declares, compares the first action of an episode with the
    observed pose. The robot has to be able to get there in one control step: by its joint speeds where these are known.

    ## Why it matters
    A target far away is where most wiring faults show: left and right exchanged, degrees for radians, differences taken
    for absolute values, a quaternion in another order, statistics of another robot. On hardware, the arm leaps.

    ## Example
    `{"left_ee_pose": action[7:14], "right_ee_pose": action[:7]}`

    ## Use instead
    Absolute targets in the order of `xpl.action.pack`, in the frames and units of the standard. A trained policy may
    leap because the scripted pictures mean nothing to it: then say so in a waiver.

    ## Fix safety
    No automatic fix.
    """
    for motion in motions.sound:
        for answer in motion.sound:
            if answer.step:
                continue
            state = answer.obs[spec.Obs.STATE]
            found = list(jumps(motion.embodiment, state, answer.chunk[0], motions.frequency))
            if found:
                yield blame(
                    f"the first {motion.action_type} action for {motion.embodiment.name} is farther from the observed "
                    f"pose than the robot moves in one step at {motions.frequency:g} Hz: it would leap",
                    expected="a first action near the observed pose",
                    got=f"{answer.where}: {'; '.join(map(str, found))}",
                    fix=Fix("advice", "look for sides exchanged, another unit or frame, or differences not added"),
                )
                break
