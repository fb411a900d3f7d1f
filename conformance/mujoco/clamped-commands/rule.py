"""XPL302: The environment clamps many of the commands."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.rules.model import CLAMPED
from xpl_cli.audit.served.probe import blame

TOLERATED = 0.05


@rule(code="XPL302", requirement="XPL-SIM-2", profile="full", tries="limits of commands")
def clamped_commands(simulation: Simulation) -> Iterator[Finding]:
    """The environment clamps many of the commands.

    ## What it does
    Counts, in a rollout of every declared robot and action type, the control steps in which a command exceeded a joint
    limit, a speed limit or the gripper's range.

    ## Why it matters
    A clamped command is not executed as commanded, and on a robot it means motion at the limit. Many of them indicate
    wrong units, a wrong normalisation or delta actions treated as absolute ones.

    ## Example
    Joint angles in degrees: every command exceeds the limits.

    ## Use instead
    Compare the first action with the observed state; they should be close.

    ## Fix safety
    No automatic fix.
    """
    kinds = frozenset(("joint_limit", "joint_speed", "gripper_range"))
    for played in simulation.sound_rollouts():
        share = played.count_corrected(kinds) / max(played.steps, 1)
        if share > TOLERATED:
            counts = played.results[0].corrections
            yield blame(
                f"in {played.setup} the environment had to clamp {share:.0%} of the commands: the robot does "
                "not execute what the policy commands",
                expected=f"at most {TOLERATED:.0%} of the steps beyond a limit of joints, speed or gripper",
                got=", ".join(f"{kind} {count} times" for kind, count in counts.items()),
                evidence={
                    "task": played.setup.task,
                    "steps": played.steps,
                    "corrections": dict(counts),
                    CLAMPED: share,
                },
                fix=Fix(
                    "advice",
                    "check units and normalisation: radians, absolute targets, gripper 0..1, the control frequency",
                ),
            )
