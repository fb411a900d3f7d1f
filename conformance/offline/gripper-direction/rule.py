"""XPL242: Gripper commands run the other way round, or in another unit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.served.compare import structure_problem
from xpl_cli.audit.served.inputs import with_grippers
from xpl_cli.audit.served.probe import Probe, blame

_OPENINGS = np.linspace(spec.GRIPPER_CLOSED, spec.GRIPPER_OPEN, 5)
_EXACT = 1e-3
"""How exactly a command has to follow the observed opening to be taken for a copy of it."""
_INVERTED, _SCALED = -0.5, 0.3


@rule(code="XPL242", requirement="XPL-ACT-5", profile="full")
def gripper_direction(probe: Probe) -> Iterator[Finding]:
    """Gripper commands run the other way round, or in another unit.

    ## What it does
    Shows grippers closed, open and in between. Where the first command is a straight-line copy of what was observed,
    the line must not fall (closed and open exchanged), and must not be flat through zero (metres for a share of the
    stroke). Of a policy that decides for itself, nothing can be said without a simulator.

    ## Why it matters
    The gripper opens where it should hold, or never opens. Everything else looks right.

    ## Example
    `1 - gripper`, for a model whose data had 0 for open, on one side of the model only.

    ## Use instead
    0 for closed and 1 for open, in the state that is encoded and in the action that is decoded.

    ## Fix safety
    No automatic fix.
    """
    probe.ready()
    arms = [arm for arm in probe.embodiment.arms if arm.gripper == "parallel_gripper"]
    if not arms:
        raise NotApplicable("the robot has no gripper that opens and closes")
    obs = probe.observation()
    with probe.session() as policy:
        chunks = [policy.act(with_grippers(obs, opening)) for opening in _OPENINGS]
    if any(structure_problem(chunk, probe.embodiment, probe.action_type) for chunk in chunks):
        raise NotApplicable("not every opening is answered by an action")
    copied = False
    for arm in arms:
        key = arm.prefix + spec.State.EE_JOINT_STATE
        commands = np.array([float(np.ravel(chunk[0][key])[0]) for chunk in chunks])
        slope, offset = np.polyfit(_OPENINGS, commands, 1)
        if np.abs(commands - (offset + slope * _OPENINGS)).max() > _EXACT or abs(slope) <= _EXACT:
            continue
        copied = True
        inverted = slope < _INVERTED
        if inverted or (abs(offset) <= _EXACT and slope < _SCALED):
            fault = (
                "open and closed are exchanged" if inverted else "they are in another unit than shares of the stroke"
            )
            yield blame(
                f"commands of {key} follow the observed gripper, but {fault}: the gripper would "
                f"{'open where it has to hold' if inverted else 'never open'}",
                expected=f"{np.round(_OPENINGS, 3).tolist()} for grippers observed there",
                got=f"{np.round(commands, 3).tolist()}",
                fix=Fix("advice", "use 0 for closed and 1 for open on both sides of the model"),
            )
    if not copied:
        raise NotApplicable("the policy's grippers do not simply follow what is observed")
