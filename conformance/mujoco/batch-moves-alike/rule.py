"""XPL305: Two environments in one batch move differently than one by one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.served.probe import blame

_SEEDS = (3, 4)
TOLERANCE = 1e-5  # float32 commands; batched kernels round differently


@rule(code="XPL305", requirement="XPL-SIM-5")
def batch_moves_alike(simulation: Simulation) -> Iterator[Finding]:
    """Two environments in one batch move differently than one by one.

    ## What it does
    Drives two seeds in one batch, then each by itself, and compares the commands.

    ## Why it matters
    Batched evaluation is how benchmarks save hours. It counts only if it measures the same policy.

    ## Example
    The second environment of a batch continues the action queue of the first.

    ## Use instead
    `xpl.Policy`, or state in dicts keyed by environment index.

    ## Fix safety
    No automatic fix.
    """
    together = simulation.steadily(_SEEDS)
    task = together.course.task
    for place, seed in enumerate(_SEEDS):
        alone = simulation.steadily(_SEEDS, only=place)
        pairs = zip(together.commands[place], alone.commands[place], strict=False)
        step = next((index for index, (a, b) in enumerate(pairs) if not np.allclose(a, b, atol=TOLERANCE)), None)
        if step is not None:
            yield blame(
                f"in {together.course} the environment with seed {seed} is driven differently beside another one "
                f"than alone, from step {step} on",
                expected="the commands of a run by itself",
                got="other commands",
                evidence={
                    "task": task,
                    spec.Deploy.SEED: seed,
                    "step": step,
                    "alone": alone.commands[place][step].tolist(),
                    "beside": together.commands[place][step].tolist(),
                },
                fix=Fix("advice", "keep all state per environment index"),
            )
            return
