"""XPL304: Commands jump between one action chunk and the next."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.physics.rollout import largest_changes
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.served.probe import blame

JOINT_FLOOR, POSITION_FLOOR = 0.1, 0.03  # rad, m: smaller changes are no jump
RATIO = 5.0


@rule(code="XPL304", requirement="XPL-SIM-4", profile="full", tries="boundaries of chunks")
def chunk_boundaries(simulation: Simulation) -> Iterator[Finding]:
    """Commands jump between one action chunk and the next.

    ## What it does
    Compares the largest change between the last command of a chunk and the first of the next with the largest change
    inside chunks. It does not apply to a policy with chunks of one step; `clamped-commands` checks how fast that moves.

    ## Why it matters
    If a chunk does not start at the robot's pose, the arm jerks at every inference: on hardware that is a safety stop.

    ## Example
    Actions are offset by one step, or normalised with the statistics of another robot.

    ## Use instead
    Predict from the newest observation; smooth with temporal ensembling where the model's chunks disagree.

    ## Fix safety
    No automatic fix.
    """
    compared = [(played, *jump) for played in simulation.sound_rollouts() for jump in largest_changes(played)]
    if not compared:
        raise NotApplicable("chunks have one step each")
    for played, seam, inside in compared:
        course = played.setup
        joint = spec.ACTION_KEYS[course.action_type][0] == spec.State.ARM_JOINT_STATE
        unit, floor = ("rad", JOINT_FLOOR) if joint else ("m", POSITION_FLOOR)
        if seam > max(floor, RATIO * inside):
            yield blame(
                f"in {course} commands jump by {seam:.3g} {unit} where a new chunk begins, and by {inside:.2g} {unit} "
                "inside chunks: the arm jerks at every inference",
                expected=f"at most {max(floor, RATIO * inside):.2g} {unit} between consecutive commands",
                got=f"{seam:.3g} {unit}",
                evidence={"task": course.task, "seam": seam, "inside": inside},
                fix=Fix(
                    "advice", "start each chunk at the current state, or declare temporal.ensembling in policy.yml"
                ),
            )
