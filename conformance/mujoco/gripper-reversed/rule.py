"""XPL307: The gripper opens where the policy means to close it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.physics.claims import claims, measure, measure_mirrored
from xpl_cli.audit.physics.loop import Rollout
from xpl_cli.audit.physics.mirrors import MIRRORED
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.served.probe import blame

_QUERIES = 4
_MIDDLE = (spec.GRIPPER_CLOSED + spec.GRIPPER_OPEN) / 2
_TRAVEL = 0.4 * abs(spec.GRIPPER_OPEN - spec.GRIPPER_CLOSED)
"""How far the gripper has to have moved in the loop for its commands to be told from a decision."""
_EVEN = 0.05
_TRIED = 4
"""Episodes in each environment whose grippers run the other way round."""


@rule(code="XPL307", requirement="XPL-SIM-7", profile="full")
def gripper_reversed(simulation: Simulation) -> Iterator[Finding]:
    """The gripper opens where the policy means to close it.

    ## What it does
    Looks in every closed loop for a gripper that contradicts itself: at every question the policy commands the side
    of the stroke on which the gripper is not, so that it swings to and fro, or comes to rest half open. Where the
    manifest claims a success rate that is not reached, it plays the same episodes in environments whose gripper
    commands, gripper observations or both run the other way round: a policy that does better there has them exchanged.

    ## Why it matters
    A policy that holds an object open-handed fails every task, and its arm moves just as it should.

    ## Example
    A model trained with 1 for closed, behind an adapter that hands its output on as it is.

    ## Use instead
    0 for closed and 1 for open, in the state that is encoded and in the action that is decoded.

    ## Fix safety
    No automatic fix.
    """
    for played in simulation.sound_rollouts():
        yield from _contradictions(played)
    for claim in claims(simulation):
        real = measure(simulation, claim.course, claim.episodes)
        if claim.success_rate <= real.success_interval.high:
            continue
        for world in MIRRORED:
            other = measure_mirrored(simulation, claim.course, _TRIED, world)
            if other.success_interval.low > real.success_rate and other.success_rate > real.success_interval.high:
                yield blame(
                    f"in {claim.course} the policy succeeds where the {world} of the gripper run the other way round: "
                    "it has open and closed exchanged",
                    expected=f"success with {spec.GRIPPER_CLOSED:g} for closed and {spec.GRIPPER_OPEN:g} for open",
                    got=f"{real.successes} of {real.episodes} episodes succeed, the other way round {other.successes} "
                    f"of {other.episodes}",
                    fix=Fix("advice", f"turn the gripper's {world} round in the adapter"),
                )
                break


def _contradictions(played: Rollout) -> Iterator[Finding]:
    keys = list(played.robot.dims(played.course.action_type))
    widths = played.robot.dims(played.course.action_type).values()
    starts = np.concatenate([[0], np.cumsum(list(widths))])
    for arm in played.robot.arms:
        key = arm.prefix + spec.State.EE_JOINT_STATE
        if arm.gripper != "parallel_gripper":
            continue
        column = int(starts[keys.index(key)])
        queries = played.queries[0]
        observed = np.array([float(np.ravel(query.state[key])[0]) for query in queries])
        commanded = np.array([float(query.chunk[0, column]) for query in queries])
        against = (observed - _MIDDLE) * (commanded - _MIDDLE) < 0
        in_the_middle = (np.abs(observed - _MIDDLE) < _EVEN) & (np.abs(commanded - _MIDDLE) < _EVEN)
        if len(queries) >= _QUERIES and np.ptp(observed) >= _TRAVEL and (against | in_the_middle).all():
            yield blame(
                f"in {played.course} commands of {key} contradict the gripper at every question: it is told to close "
                "because it is open, and to open because it is closed",
                expected="commands that do not turn round whenever they were obeyed",
                got=f"{np.round(commanded[:8], 2).tolist()} for grippers at {np.round(observed[:8], 2).tolist()}",
                evidence={"task": played.course.task, "questions": len(queries)},
                fix=Fix("advice", "use 0 for closed and 1 for open on both sides of the model"),
            )
