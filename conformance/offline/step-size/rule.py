"""XPL239: Consecutive actions of a chunk are farther apart than the robot can move."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.limits import jumps
from xpl_cli.audit.offline.motion import MotionEpisodes
from xpl_cli.audit.served.probe import blame


@rule(code="XPL239", requirement="XPL-ACT-15", profile="full", tries="limits and step sizes")
def step_size(motions: MotionEpisodes) -> Iterator[Finding]:
    """Consecutive actions of a chunk are farther apart than the robot can move.

    ## What it does
    Compares each action step of a chunk with the previous one. The robot has to be able to follow in one control step,
    at the frequency that the manifest declares: by its joint speeds if these are known. Grippers may jump.

    ## Why it matters
    The robot executes only a part of a step that it cannot follow, and the arm arrives in another pose than the model
    planned. Either the chunk is out of order, or the declared frequency is not the one that the model was trained at.

    ## Example
    `actions[::4]` to "skip frames", while `control_frequency` is still 50.

    ## Use instead
    The model's own rate as `control_frequency`, and every action step in its order.

    ## Fix safety
    No automatic fix.
    """
    if all(len(answer.chunk) == 1 for motion in motions.sound for answer in motion.sound):
        raise NotApplicable("every chunk holds one action: there is no next one to compare it with")
    for motion in motions.sound:
        excesses = [
            (answer, index, excess)
            for answer in motion.sound
            for index, (before, after) in enumerate(pairwise(answer.chunk))
            for excess in jumps(motion.embodiment, before, after, motions.frequency)
        ]
        if excesses:
            motions.require_trained()
            answer, index, excess = max(excesses, key=lambda entry: entry[2].value / entry[2].limit)
            yield blame(
                f"{motion.action_type} chunks for {motion.embodiment.name} jump from one action to the next: at "
                f"{motions.frequency:g} Hz the robot cannot follow ({excess.what})",
                expected=f"at most {excess.limit:.3g} {excess.unit} in one step",
                got=f"{excess.value:.3g} {excess.unit} from action {index} to the next ({answer.where})",
                fix=Fix(
                    "advice", "keep the order of the model's steps, and declare the frequency of its training data"
                ),
            )
