"""XPL305: Two environments in one batch move differently from single ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.physics.loop import Query, Rollout
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.served.probe import blame
from xpl_cli.audit.served.rounding import rounding_limit

_SEEDS = (3, 4)
TOLERANCE = 1e-5  # float32 commands


@rule(code="XPL305", requirement="XPL-SIM-5")
def batch_motion(simulation: Simulation) -> Iterator[Finding]:
    """Two environments in one batch move differently from single ones.

    ## What it does
    Runs two seeds in one batch. Then each environment repeats its motion alone, and the policy's actions are compared:
    the observations are the same, so rounding does not accumulate. Where actions differ, the same observation is sent
    in every slot of a batch of that size. A difference to that is an effect of another environment, and counts. What
    remains is batch-size-dependent floating-point error: up to 2 % of the range of the actions or half a percent of the
    largest number.

    ## Why it matters
    Batched evaluation saves benchmarks hours. It is valid only if it measures the same policy.

    ## Example
    The second environment of a batch continues the action queue of the first.

    ## Use instead
    `xpl.Policy`, or state in dicts keyed by environment index.

    ## Fix safety
    No automatic fix.
    """
    together = simulation.together(_SEEDS)
    for place, seed in enumerate(_SEEDS):
        beside, alone = together.queries[place], simulation.alone(_SEEDS, place).queries[place]
        found = _apart(beside, alone, TOLERANCE)
        if found is None or _is_rounding(simulation, place):
            continue
        step, there, by_itself = found
        yield blame(
            f"in {together.course} the environment with seed {seed} gets other actions in a batch than alone, "
            f"from step {step} on",
            expected="the commands of a run by itself",
            got="other commands",
            evidence={
                "task": together.course.task,
                spec.Deploy.SEED: seed,
                "step": step,
                "alone": by_itself.tolist(),
                "beside": there.tolist(),
            },
            fix=Fix("advice", "keep all state per environment index"),
        )
        return


def _is_rounding(simulation: Simulation, place: int) -> bool:
    """Whether answers in a batch differ by its size alone, and by no more than it may round."""
    together = simulation.together(_SEEDS)
    copied = simulation.beside_itself(_SEEDS, place).queries[place]
    if _apart(together.queries[place], copied, TOLERANCE) is not None:
        return False
    alone = simulation.alone(_SEEDS, place).queries[place]
    return _apart(together.queries[place], alone, _rounded(together, alone)) is None


def _rounded(played: Rollout, alone: Sequence[Query]) -> np.ndarray:
    """Return by how much batches may round each number of an action."""
    rows = np.concatenate([query.chunk for query in alone])
    widths = list(played.robot.dims(played.course.action_type).values())
    keys = np.split(rows, np.cumsum(widths)[:-1], axis=1)
    return np.repeat([rounding_limit(values) for values in keys], widths)


def _apart(
    beside: Sequence[Query], alone: Sequence[Query], tolerance: float | np.ndarray
) -> tuple[int, np.ndarray, np.ndarray] | None:
    """Return the first control step at which answers differ, and what is commanded then; None if none does.

    Of chunks of different lengths that is the step at which the shorter one has ended.
    """
    for one, other in zip(beside, alone, strict=True):
        count = min(len(one.chunk), len(other.chunk))
        for index in range(count):
            if not np.allclose(one.chunk[index], other.chunk[index], atol=tolerance):
                return one.step + index, one.chunk[index], other.chunk[index]
        if len(one.chunk) != len(other.chunk):
            return one.step + count, one.chunk[count:], other.chunk[count:]
    return None
