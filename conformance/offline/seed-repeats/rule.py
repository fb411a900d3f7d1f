"""XPL214: Two runs with one seed give different actions."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotRun, rule
from xpl_cli.audit.offline.configurations import Configurations
from xpl_cli.audit.served.probe import blame


@rule(code="XPL214", requirement="XPL-CFG-2", loads=True, compares=True, tries="seeds")
def seed_repeats(configurations: Configurations) -> Iterator[Finding]:
    """Two runs with one seed give different actions.

    ## What it does
    Runs the same episode in two fresh servers with seed 0, and in two with seed 7.

    ## Why it matters
    A result that cannot be repeated cannot be compared. Seed 0 is the usual default, and the one that `seed or 42`
    replaces.

    ## Example
    `np.random.normal()` from the process-wide generator, which is not seeded.

    ## Use instead
    `self.rng(env)`, or seed the framework's generators from `self.seed`; declare `deterministic: false` if neither is
    possible.

    ## Fix safety
    No automatic fix.
    """
    configurations.probe.require_deterministic()
    for seed in (0, 7):
        first, second = (configurations.with_seed(seed, run) for run in range(2))
        if first.refusal is not None and second.refusal is not None:
            raise NotRun(f"the policy is not served with seed {seed}: {first.refusal}")
        mismatch = first.difference(second)
        if mismatch is not None:
            yield blame(
                f"two servers with seed {seed} act differently: a run cannot be repeated",
                expected="the same actions",
                got=mismatch,
                fix=Fix("advice", "draw every random number from self.rng(env), or declare deterministic: false"),
            )
            return
