"""XPL306: End-effector targets are out of reach."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.probe import blame
from xpl_cli.audit.simulation import Simulation

TOLERATED = 0.05


@rule(code="XPL306", slug="reachable", gate="mujoco", requirement="XPL-SIM-6", profile="full")
def reachable(simulation: Simulation) -> Iterator[Finding]:
    """End-effector targets are out of reach.

    ## What it does
    Counts the control steps whose commanded flange pose the inverse kinematics could not reach.

    ## Why it matters
    The arm goes to the nearest pose it can take and waits there. Usually the frame, the unit or the order of the
    quaternion is another one than the standard's.

    ## Example
    Poses relative to the arm's base in a scene where the base stands elsewhere, or quaternions as [x, y, z, w].

    ## Use instead
    Compare the first target with the observed `ee_pose`: they have the same meaning.

    ## Fix safety
    No automatic fix.
    """
    if simulation.probe.action_type == spec.ACTION_TYPES[0]:
        raise NotApplicable("the adapter is served for joint control")
    for task in simulation.tasks():
        played = simulation.sound_rollout(task)
        share = played.corrected(frozenset(("unreachable",))) / max(played.steps, 1)
        if share > TOLERATED:
            yield blame(
                f"in {task} {share:.0%} of the end-effector targets cannot be reached: the arm stops at the edge "
                "of its workspace",
                expected=f"at most {TOLERATED:.0%} of the targets out of reach",
                got=f"{share:.0%}",
                evidence={"task": task, "first_target": played.commands[0][0].tolist()},
                fix=Fix("advice", "poses are [x, y, z, qw, qx, qy, qz] of the flange in the world frame, metres"),
            )
