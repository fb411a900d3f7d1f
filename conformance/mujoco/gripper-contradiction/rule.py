"""XPL307: The gripper moves against the policy's apparent intention."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotRun, rule
from xpl_cli.audit.physics.rollout import PhysicsRollout
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.physics.success_rates import claimed_rates, measure, measure_swapped
from xpl_cli.audit.physics.swaps import GRIPPER_SWAPS, EnvSwap, image_swaps
from xpl_cli.audit.served.probe import blame

_LEAST_INFERENCES = 4
_MIDDLE = (spec.GRIPPER_CLOSED + spec.GRIPPER_OPEN) / 2
_TRAVEL = 0.4 * abs(spec.GRIPPER_OPEN - spec.GRIPPER_CLOSED)
"""Least range of gripper and commands in a rollout that rules out a decision of the policy."""
_EVEN = 0.05
_RARE = 0.25
"""Largest share of inferences at which a gripper changes sides although its commands agree with it."""
_TRIED = 4
"""Episodes in each swapped environment."""
_COMPARE = "compare the model's gripper input, and the meaning of its output, with the authors' own code"


@rule(code="XPL307", requirement="XPL-SIM-7", profile="full", tries="grippers")
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
    for rollout in simulation.sound_rollouts():
        yield from _contradictions(simulation, rollout)
    for claim in claimed_rates(simulation):
        real = measure(simulation, claim.setup, claim.episodes)
        if claim.success_rate <= real.success_interval.high:
            continue
        for swap in (*image_swaps(simulation.cameras), *GRIPPER_SWAPS):
            other = measure_swapped(simulation, claim.setup, _TRIED, swap)
            if other.success_interval.low > real.success_rate and other.success_rate > real.success_interval.high:
                yield blame(
                    f"in {claim.setup} the policy succeeds if {swap}, and not without that swap",
                    expected="success in the environment as it is",
                    got=f"{real.successes} of {real.episodes} episodes succeed, with the swap {other.successes} of "
                    f"{other.episodes}",
                    fix=Fix("advice", swap.advice),
                )
                break


def _contradictions(simulation: Simulation, rollout: PhysicsRollout) -> Iterator[Finding]:
    for key, observed, commanded in _grippers(rollout):
        if not _contradicts(observed, commanded):
            continue
        swaps = list(_agreeing_swaps(simulation, rollout, key))
        elsewhere = f"; they agree with it if {', or if '.join(map(str, swaps))}" if swaps else ""
        yield blame(
            f"in {rollout.setup} commands of {key} contradict the gripper at every inference: to close when it "
            f"is open, and to open when it is closed{elsewhere}",
            expected="commands that do not reverse after they were executed",
            got=f"{np.round(commanded[:8], 2).tolist()} for grippers at {np.round(observed[:8], 2).tolist()}",
            evidence={"task": rollout.setup.task, "questions": len(observed), "agrees_where": list(map(str, swaps))},
            fix=Fix("advice", swaps[0].advice if swaps else _COMPARE),
        )


def _agreeing_swaps(simulation: Simulation, rollout: PhysicsRollout, key: str) -> Iterator[EnvSwap]:
    """Yield the swaps with which commands agree with the gripper, those of images first."""
    for swap in (*image_swaps(simulation.cameras), *GRIPPER_SWAPS):
        try:
            other = simulation.swapped_rollout(rollout.setup, swap)
        except NotRun:
            continue
        values = next(values for name, *values in _grippers(other) if name == key)
        against, between = _sides(*swap.unswap(*values))
        if len(against) >= _LEAST_INFERENCES and (against | between)[1:].mean() <= _RARE:
            yield swap


def _grippers(rollout: PhysicsRollout) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield each gripper's key, its observed openings and its commands, one of each per inference."""
    dims = rollout.robot.dims(rollout.setup.action_type)
    starts = dict(zip(dims, np.cumsum([0, *dims.values()])[:-1], strict=True))
    inferences = rollout.inferences[0]
    for arm in rollout.robot.arms:
        key = arm.prefix + spec.State.EE_JOINT_STATE
        if arm.gripper == "parallel_gripper":
            observed = np.array([float(np.ravel(inference.state[key])[0]) for inference in inferences])
            yield key, observed, np.array([float(inference.chunk[0, starts[key]]) for inference in inferences])


def _contradicts(observed: np.ndarray, commanded: np.ndarray) -> bool:
    against, between = _sides(observed, commanded)
    moved = min(np.ptp(observed), np.ptp(commanded))
    return bool(len(observed) >= _LEAST_INFERENCES and moved >= _TRAVEL and (against | between).all())


def _sides(observed: np.ndarray, commanded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return at which inferences a command is on the other side, and at which gripper and command are half open."""
    here, there = observed - _MIDDLE, commanded - _MIDDLE
    is_between = (np.abs(here) < _EVEN) & (np.abs(there) < _EVEN)
    return (here * there < 0) & (np.minimum(np.abs(here), np.abs(there)) >= _EVEN), is_between
