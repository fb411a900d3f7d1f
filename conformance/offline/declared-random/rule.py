"""XPL248: A policy that is declared not deterministic is deterministic."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, NotRun, rule
from xpl_cli.audit.offline.configurations import Configurations
from xpl_cli.audit.served.probe import blame


@rule(code="XPL248", requirement="XPL-CFG-12", profile="full", tries="declared randomness")
def declared_random(configurations: Configurations) -> Iterator[Finding]:
    """A policy that is declared not deterministic is deterministic.

    ## What it does
    Runs one episode with two seeds, if the manifest declares `deterministic: false`.

    ## Why it matters
    The declaration disables every rule that compares actions, such as whether environments influence each other or an
    episode depends on the previous one. Here it disables them without need.

    ## Example
    `deterministic: false`, and a model that draws no random number.

    ## Use instead
    `deterministic: true`. A policy that draws its numbers from the run's seed is deterministic, too.

    ## Fix safety
    No automatic fix.
    """
    if configurations.probe.package.manifest.deterministic:
        raise NotApplicable("the policy is declared deterministic")
    seeds = (0, 7)
    first, second = (configurations.with_seed(seed) for seed in seeds)
    if first.refusal is not None:
        raise NotRun(f"the policy is not served with seed {seeds[0]}: {first.refusal}")
    if first.difference(second) is None:
        yield blame(
            f"seeds {seeds[0]} and {seeds[1]} give the same actions, and policy.yml declares the policy not "
            "deterministic: rules that compare actions are disabled without need",
            expected="actions that differ, or deterministic: true",
            got="the same actions in two servers",
            fix=Fix("advice", "declare deterministic: true"),
        )
