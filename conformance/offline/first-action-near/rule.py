"""XPL237: The first action of an episode is far from the robot's pose."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.offline.limits import Excess, jumps
from xpl_cli.audit.offline.motion import MotionEpisode, MotionEpisodes
from xpl_cli.audit.offline.parity.fact import Parity
from xpl_cli.audit.rules.model import SHARED
from xpl_cli.audit.served.probe import blame


@rule(code="XPL237", requirement="XPL-ACT-8", profile="full", tries="limits and step sizes")
def first_action_near(motions: MotionEpisodes, parity: Parity) -> Iterator[Finding]:
    """The first action of an episode is far from the robot's pose.

    ## What it does
    With every embodiment and action type that the manifest declares, compares the first action of an episode with the
    observed pose. The robot has to be able to reach it in one control step: by its joint speeds if these are known. If
    the first actions of the golden pairs are less than half as far away, the audit fails. Otherwise it warns, and the
    verdict says that both may have the same mistake.

    ## Why it matters
    A first target far away is a sign of most conversion mistakes: left and right swapped, degrees for radians, delta
    actions treated as absolute ones, another quaternion order, statistics of another robot. On hardware, the arm leaps.

    ## Example
    `{"left_ee_pose": action[7:14], "right_ee_pose": action[:7]}`

    ## Use instead
    Absolute targets in the order of `xpl.action.pack`, in the frames and units of the standard. A trained policy may
    leap because the synthetic images mean nothing to it: golden pairs show whether it does, and without them a waiver
    may accept it.

    ## Fix safety
    No automatic fix.
    """
    for motion in motions.sound:
        for answer in motion.sound:
            if answer.step:
                continue
            state = answer.obs[spec.Obs.STATE]
            excesses = list(jumps(motion.embodiment, state, answer.chunk[0], motions.frequency))
            if excesses:
                leap, own = _farthest(excesses), _golden_leap(parity, motion, motions.frequency)
                is_foreign = own is not None and leap > _FOREIGN * own
                if own is None:
                    motions.require_trained()
                yield blame(
                    f"the first {motion.action_type} action for {motion.embodiment.name} is farther from the observed "
                    f"pose than the robot moves in one step at {motions.frequency:g} Hz: it would leap"
                    f"{_beside(own, is_foreign=is_foreign)}",
                    expected="a first action near the observed pose",
                    got=f"{answer.where}: {'; '.join(map(str, excesses))}",
                    evidence={SHARED: own is not None and not is_foreign},
                    fix=Fix("advice", _LOOK if own is None or is_foreign else _SHARED),
                    must=is_foreign,
                )
                break


_FOREIGN = 2.0
"""How many times as far as the model's own first actions one has to be for the leap not to be the model's."""
_LOOK = (
    "check for swapped sides, another unit or frame, or delta actions that were not added; golden-parity compares "
    "all actions"
)
_SHARED = (
    "it is the model's reaction to synthetic images, or reference.py and the adapter share a mistake: compare "
    "both with rows of the authors' data (model_io.samples) or demonstrations"
)


def _beside(own: float | None, *, is_foreign: bool) -> str:
    if own is None:
        return ""
    return ", which those in golden_pairs.json do not" if is_foreign else ", as those in golden_pairs.json do"


def _farthest(excesses: Iterable[Excess]) -> float:
    """Return how many times as far as a robot moves in one step the farthest is, at least 1."""
    return max((excess.value / excess.limit for excess in excesses), default=1.0)


def _golden_leap(parity: Parity, motion: MotionEpisode, frequency: float) -> float | None:
    """Return how far golden first actions are, in steps of the robot, at least 1; None without pairs of this robot."""
    recorded = parity.recorded
    first_questions = [
        (session, question)
        for session in (recorded.sessions if recorded is not None else ())
        if (session.embodiment, session.action_type) == (motion.embodiment.name, motion.action_type)
        for question in session.questions
        if len(question.asked_at) == 1
    ]
    if not first_questions:
        return None
    return max(
        _farthest(jumps(session.robot, session.state(question), session.chunk(question)[0], frequency))
        for session, question in first_questions
    )
