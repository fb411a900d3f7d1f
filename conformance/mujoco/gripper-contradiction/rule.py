"""XPL307: The gripper moves against the policy's apparent intention."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotRun, rule
from xpl_cli.audit.physics.claims import claims, measure, measure_mirrored
from xpl_cli.audit.physics.loop import Rollout
from xpl_cli.audit.physics.mirrors import GRIPPERS_TURNED, World, pictured
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.served.probe import blame

_QUERIES = 4
_MIDDLE = (spec.GRIPPER_CLOSED + spec.GRIPPER_OPEN) / 2
_TRAVEL = 0.4 * abs(spec.GRIPPER_OPEN - spec.GRIPPER_CLOSED)
"""How far gripper and commands have to have moved in the loop for them to be told from a decision."""
_EVEN = 0.05
_SELDOM = 0.25
"""Share of the questions at which a gripper may change sides where its commands agree with it."""
_TRIED = 4
"""Episodes in each environment in which something is exchanged."""
_COMPARE = "compare the model's gripper input, and the meaning of its output, with the authors' own code"


@rule(code="XPL307", requirement="XPL-SIM-7", profile="full")
def gripper_contradiction(simulation: Simulation) -> Iterator[Finding]:
    """The gripper moves against the policy's apparent intention.

    ## What it does
    Looks in every rollout for a gripper that contradicts itself: at every inference the policy commands the side of the
    stroke opposite to the observed one, so that the gripper oscillates, or stops half open. It also measures the
    success rate that the manifest claims. If it finds either, it repeats the rollout in environments with one thing
    swapped: red and blue of the images, the images of two cameras, gripper commands, gripper observations or both. A
    finding says what was measured, and with which swap the policy does better. The cause is where the adapter differs
    from the authors' own code.

    ## Why it matters
    A policy that opens the gripper on a grasped object fails every task, although its arm moves correctly.

    ## Example
    A model trained with 1 for closed, in an adapter that returns its output unchanged. Images in BGR may have the same
    effect in a rollout: the object is not recognised, and the gripper opens.

    ## Use instead
    0 for closed and 1 for open, in the encoded state and in the decoded action, if the authors' own code has it the
    other way round.

    ## Fix safety
    No automatic fix.
    """
    for played in simulation.sound_rollouts():
        yield from _contradictions(simulation, played)
    for claim in claims(simulation):
        real = measure(simulation, claim.course, claim.episodes)
        if claim.success_rate <= real.success_interval.high:
            continue
        for world in (*pictured(simulation.cameras), *GRIPPERS_TURNED):
            other = measure_mirrored(simulation, claim.course, _TRIED, world)
            if other.success_interval.low > real.success_rate and other.success_rate > real.success_interval.high:
                yield blame(
                    f"in {claim.course} the policy succeeds if {world}, and not without that swap",
                    expected="success in the environment as it is",
                    got=f"{real.successes} of {real.episodes} episodes succeed, with the swap {other.successes} of "
                    f"{other.episodes}",
                    fix=Fix("advice", world.advice),
                )
                break


def _contradictions(simulation: Simulation, played: Rollout) -> Iterator[Finding]:
    for key, observed, commanded in _grippers(played):
        if not _contradicts(observed, commanded):
            continue
        worlds = list(_where_it_agrees(simulation, played, key))
        elsewhere = f"; they agree with it if {', or if '.join(map(str, worlds))}" if worlds else ""
        yield blame(
            f"in {played.course} commands of {key} contradict the gripper at every inference: to close when it "
            f"is open, and to open when it is closed{elsewhere}",
            expected="commands that do not reverse after they were executed",
            got=f"{np.round(commanded[:8], 2).tolist()} for grippers at {np.round(observed[:8], 2).tolist()}",
            evidence={"task": played.course.task, "questions": len(observed), "agrees_where": list(map(str, worlds))},
            fix=Fix("advice", worlds[0].advice if worlds else _COMPARE),
        )


def _where_it_agrees(simulation: Simulation, played: Rollout, key: str) -> Iterator[World]:
    """Yield the worlds in which the gripper is told to go where it is or goes already, those of the pictures first."""
    for world in (*pictured(simulation.cameras), *GRIPPERS_TURNED):
        try:
            other = simulation.mirrored(played.course, world)
        except NotRun:
            continue
        values = next(values for name, *values in _grippers(other) if name == key)
        against, between = _sides(*world.real(*values))
        if len(against) >= _QUERIES and (against | between)[1:].mean() <= _SELDOM:
            yield world


def _grippers(played: Rollout) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield each gripper's key, with where it was seen at every question and what it was told."""
    dims = played.robot.dims(played.course.action_type)
    starts = dict(zip(dims, np.cumsum([0, *dims.values()])[:-1], strict=True))
    queries = played.queries[0]
    for arm in played.robot.arms:
        key = arm.prefix + spec.State.EE_JOINT_STATE
        if arm.gripper == "parallel_gripper":
            observed = np.array([float(np.ravel(query.state[key])[0]) for query in queries])
            yield key, observed, np.array([float(query.chunk[0, starts[key]]) for query in queries])


def _contradicts(observed: np.ndarray, commanded: np.ndarray) -> bool:
    against, between = _sides(observed, commanded)
    moved = min(np.ptp(observed), np.ptp(commanded))
    return bool(len(observed) >= _QUERIES and moved >= _TRAVEL and (against | between).all())


def _sides(observed: np.ndarray, commanded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return at which questions a gripper is told to go to the other side, and at which it is and stays between."""
    here, there = observed - _MIDDLE, commanded - _MIDDLE
    is_between = (np.abs(here) < _EVEN) & (np.abs(there) < _EVEN)
    return (here * there < 0) & (np.minimum(np.abs(here), np.abs(there)) >= _EVEN), is_between
