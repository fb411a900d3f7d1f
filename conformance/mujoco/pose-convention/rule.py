"""XPL308: Actions and observations use different conventions."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.physics.conventions import mismatches
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.served.probe import blame


@rule(code="XPL308", requirement="XPL-SIM-8", profile="full", tries="conventions of poses")
def pose_convention(simulation: Simulation) -> Iterator[Finding]:
    """Actions and observations use different conventions.

    ## What it does
    Compares, in a rollout of every declared robot and action type, the first action of each chunk with the robot's
    observed pose. They should be close. It is reported if they never are, but always agree after one conversion: the
    TCP between the fingertips for the flange, the frame of the arm's base for the world frame, a quaternion in the
    order xyzw, millimetres, degrees, the other arm.

    ## Why it matters
    The arm creeps, leaps or stops at the edge of its workspace, although keys, dimensions and norms are valid. Only if
    the robot executes actions and reports its pose, the two conventions can be compared.

    ## Example
    A model trained on TCP poses, whose output is returned as `ee_pose`: the arm moves ahead by the length of the
    gripper, again and again.

    ## Use instead
    `[x, y, z, qw, qx, qy, qz]` of the flange in the world frame, metres; joint angles in radians; left before right.

    ## Fix safety
    No automatic fix.
    """
    for played in simulation.sound_rollouts():
        for mistake in mismatches(played.robot, played.setup.action_type, played.inferences[0]):
            yield blame(
                f"in {played.setup} {mistake.key} is commanded as {mistake.what}: the robot moves away from "
                "the pose that the policy means",
                expected=f"commands near the observed {mistake.key}, at first {list(mistake.observed)}",
                got=f"{list(mistake.commanded)}",
                evidence={"task": played.setup.task, "questions": len(played.inferences[0])},
                fix=Fix("advice", mistake.advice),
            )
