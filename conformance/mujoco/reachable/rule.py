"""XPL306: End-effector targets are out of reach."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.served.probe import blame

TOLERATED = 0.05


@rule(code="XPL306", requirement="XPL-SIM-6", profile="full", tries="reach")
def reachable(simulation: Simulation) -> Iterator[Finding]:
    """End-effector targets are out of reach.

    ## What it does
    Counts, in a rollout of every declared robot, the control steps whose commanded flange pose the inverse kinematics
    could not reach.

    ## Why it matters
    The arm moves to the nearest pose that it can reach and waits there. Usually the frame, the unit or the quaternion
    order differs from the standard's.

    ## Example
    Poses relative to the arm's base in a scene with the base elsewhere, or quaternions as [x, y, z, w].

    ## Use instead
    Compare the first target with the observed `ee_pose`: they have the same meaning.

    ## Fix safety
    No automatic fix.
    """
    posed = [
        played
        for played in simulation.sound_rollouts()
        if spec.ACTION_KEYS[played.setup.action_type][0] == spec.State.EE_POSE
    ]
    if not posed:
        raise NotApplicable("the adapter's actions are joint positions, not poses")
    for played in posed:
        share = played.count_corrected(frozenset(("unreachable",))) / max(played.steps, 1)
        if share > TOLERATED:
            yield blame(
                f"in {played.setup} {share:.0%} of the end-effector targets cannot be reached: the arm stops at the "
                "edge of its workspace",
                expected=f"at most {TOLERATED:.0%} of the targets out of reach",
                got=f"{share:.0%}",
                evidence={"task": played.setup.task, "first_target": played.commands[0][0].tolist()},
                fix=Fix("advice", "poses are [x, y, z, qw, qx, qy, qz] of the flange in the world frame, metres"),
            )
