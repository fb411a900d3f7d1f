"""XPL305: Two environments in one batch move differently than one by one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.physics.loop import Query
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.served.probe import blame

_SEEDS = (3, 4)
TOLERANCE = 1e-5  # float32 commands; batched kernels round differently, and those of a GPU are asked how much


@rule(code="XPL305", requirement="XPL-SIM-5")
def batch_moves_alike(simulation: Simulation) -> Iterator[Finding]:
    """Two environments in one batch move differently than one by one.

    ## What it does
    Drives two seeds in one batch. Then each is moved by itself as it was there, and the answers are compared: what is
    seen is the same, so that rounding does not add up. What larger batches round is left out, as in XPL207.

    ## Why it matters
    Batched evaluation is how benchmarks save hours. It counts only if it measures the same policy.

    ## Example
    The second environment of a batch continues the action queue of the first.

    ## Use instead
    `xpl.Policy`, or state in dicts keyed by environment index.

    ## Fix safety
    No automatic fix.
    """
    together = simulation.together(_SEEDS)
    for place, seed in enumerate(_SEEDS):
        asked = together.queries[place], simulation.alone(_SEEDS, place).queries[place]
        found = _apart(*asked, TOLERANCE) and _apart(*asked, TOLERANCE + simulation.rounding)
        if found is not None:
            step, beside, alone = found
            yield blame(
                f"in {together.course} the environment with seed {seed} is driven differently beside another one "
                f"than alone, from step {step} on",
                expected="the commands of a run by itself",
                got="other commands",
                evidence={
                    "task": together.course.task,
                    spec.Deploy.SEED: seed,
                    "step": step,
                    "alone": alone.tolist(),
                    "beside": beside.tolist(),
                },
                fix=Fix("advice", "keep all state per environment index"),
            )
            return


def _apart(
    beside: Sequence[Query], alone: Sequence[Query], tolerance: float
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
