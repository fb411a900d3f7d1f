"""XPL305: Two environments in one batch move differently from single ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.physics.rollout import PhysicsInference, PhysicsRollout
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.served.probe import blame
from xpl_cli.audit.served.rounding import rounding_limit

_SEEDS = (3, 4)
TOLERANCE = 1e-5  # float32 commands


@rule(code="XPL305", requirement="XPL-SIM-5", tries="batches against single runs")
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
    together = simulation.batch_rollout(_SEEDS)
    for index, seed in enumerate(_SEEDS):
        in_batch, alone = together.inferences[index], simulation.single_rollout(_SEEDS, index).inferences[index]
        difference = _apart(in_batch, alone, TOLERANCE)
        if difference is None or _is_rounding(simulation, index):
            continue
        step, there, single = difference
        yield blame(
            f"in {together.setup} the environment with seed {seed} gets other actions in a batch than alone, "
            f"from step {step} on",
            expected="the commands of a run alone",
            got="other commands",
            evidence={
                "task": together.setup.task,
                spec.Deploy.SEED: seed,
                "step": step,
                "alone": single.tolist(),
                "beside": there.tolist(),
            },
            fix=Fix("advice", "keep all state per environment index"),
        )
        return


def _is_rounding(simulation: Simulation, env_index: int) -> bool:
    """Return whether actions differ only by batch-size-dependent floating-point error."""
    together = simulation.batch_rollout(_SEEDS)
    copied = simulation.repeated_rollout(_SEEDS, env_index).inferences[env_index]
    if _apart(together.inferences[env_index], copied, TOLERANCE) is not None:
        return False
    alone = simulation.single_rollout(_SEEDS, env_index).inferences[env_index]
    return _apart(together.inferences[env_index], alone, _rounded(together, alone)) is None


def _rounded(rollout: PhysicsRollout, alone: Sequence[PhysicsInference]) -> np.ndarray:
    """Return the largest floating-point error of each number of an action, (D,)."""
    rows = np.concatenate([query.chunk for query in alone])
    widths = list(rollout.robot.dims(rollout.setup.action_type).values())
    keys = np.split(rows, np.cumsum(widths)[:-1], axis=1)
    return np.repeat([rounding_limit(values) for values in keys], widths)


def _apart(
    in_batch: Sequence[PhysicsInference], alone: Sequence[PhysicsInference], tolerance: float | np.ndarray
) -> tuple[int, np.ndarray, np.ndarray] | None:
    """Return the first control step at which actions differ, with both actions; None if there is none.

    Of chunks of different lengths that is the step at which the shorter one has ended.
    """
    for one, other in zip(in_batch, alone, strict=True):
        count = min(len(one.chunk), len(other.chunk))
        for index in range(count):
            if not np.allclose(one.chunk[index], other.chunk[index], atol=tolerance):
                return one.step + index, one.chunk[index], other.chunk[index]
        if len(one.chunk) != len(other.chunk):
            return one.step + count, one.chunk[count:], other.chunk[count:]
    return None
