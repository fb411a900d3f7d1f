"""XPL303: Equal seeds give different motion."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.served.probe import blame

_SEED = 1


@rule(code="XPL303", requirement="XPL-SIM-3", tries="equal seeds")
def same_seed_same_motion(simulation: Simulation) -> Iterator[Finding]:
    """Equal seeds give different motion.

    ## What it does
    Runs the same task with the same seed with two fresh servers and compares the digests of the trajectories.

    ## Why it matters
    Paired comparisons between policies, and every claim about a difference of a few percent, require runs that are
    repeatable.

    ## Example
    Sampling noise from an unseeded generator.

    ## Use instead
    `self.rng(env)`, or `deterministic: false` in the manifest if the framework cannot be seeded.

    ## Fix safety
    No automatic fix.
    """
    simulation.probe.require_deterministic()
    first, again = (simulation.fresh_rollout((_SEED,), run=run) for run in range(2))
    if first.digests != again.digests:
        step = next(
            (
                index
                for index, (a, b) in enumerate(zip(first.commands[0], again.commands[0], strict=False))
                if (a != b).any()
            ),
            0,
        )
        yield blame(
            f"two runs of {first.setup} with one seed move differently from step {step} on",
            expected=first.digests[0],
            got=again.digests[0],
            evidence={"task": first.setup.task, spec.Deploy.SEED: _SEED, "first_difference": step},
            fix=Fix(
                "advice", "draw random numbers from self.rng(env); declare deterministic: false if that is impossible"
            ),
        )
