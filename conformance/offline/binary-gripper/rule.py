"""XPL256: A gripper that is declared binary gets a command between closed and open."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.motion import MotionEpisodes
from xpl_cli.audit.served.probe import Probe, blame

_HAND = "hand"
_STATES = np.array([sdk.GRIPPER_CLOSED, sdk.GRIPPER_OPEN])
_EXACT = 1e-3
"""How near a command is to closed or open when it is meant: float32 and its way over the wire."""


@rule(code="XPL256", requirement="XPL-ACT-17", profile="full", tries="grippers")
def binary_gripper(probe: Probe, motions: MotionEpisodes) -> Iterator[Finding]:
    """A gripper that is declared binary gets a command between closed and open.

    ## What it does
    Checks the gripper commands of a short episode, with every embodiment that has a gripper, if `policy.yml` declares
    `gripper: {command: binary}`.

    ## Why it matters
    A gripper with two states rounds values in between, and another one stops half way: the same policy acts differently
    on two robots. A comparison of policies counts a hesitation as an opening.

    ## Example
    The network's probability of closing, unchanged.

    ## Use instead
    Decide in `decode`: `(raw > 0.5).astype(np.float32)`. Or declare `command: position`, if an opening is meant.

    ## Fix safety
    No automatic fix.
    """
    gripper = probe.package.manifest.gripper
    if gripper is None or gripper.command != "binary":
        raise NotApplicable("the manifest does not declare a binary gripper")
    arms = [(motion, arm) for motion in motions.sound for arm in motion.embodiment.arms if arm.gripper != _HAND]
    if not arms:
        raise NotApplicable("no robot has a gripper that opens and closes")
    reported = set()
    for motion, arm in arms:
        key = arm.prefix + sdk.State.EE_JOINT_STATE
        for answer in motion.sound:
            commands = np.array([float(np.ravel(action[key])[0]) for action in answer.chunk])
            away = np.abs(commands[:, None] - _STATES).min(axis=1)
            worst = int(np.argmax(away))
            if away[worst] > _EXACT and (motion.embodiment.name, key) not in reported:
                reported.add((motion.embodiment.name, key))
                yield blame(
                    f"{key} of {motion.embodiment.name} is commanded to {commands[worst]:.3g}, and only closed "
                    "and open are declared: a gripper of two states would round it",
                    expected=f"{sdk.GRIPPER_CLOSED:g} or {sdk.GRIPPER_OPEN:g}, or a declared position",
                    got=f"{commands[worst]:.4g} ({answer.where}, action {worst} of the chunk)",
                    fix=Fix("advice", "round in decode, or declare command: position"),
                )
