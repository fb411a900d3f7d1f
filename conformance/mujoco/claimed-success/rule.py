"""XPL311: The manifest claims a success rate that differs from the measured one."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.physics.success_rates import USUAL_EPISODES, claimed_rates, measure
from xpl_cli.audit.rules.measurements import ENVIRONMENT


@rule(code="XPL311", requirement="XPL-SIM-11", profile="full", tries="claimed success rates")
def claimed_success(simulation: Simulation) -> Iterator[Finding]:
    """The manifest claims a success rate that differs from the measured one.

    ## What it does
    Runs whole episodes on the fixed seeds of every task for which `policy.yml` claims a success rate in this
    environment, and compares the claim with the 95 % confidence interval of the measured rate. Without a claim a few
    episodes run for the report, and nothing is judged.

    ## Why it matters
    A success rate in a manifest is read as that of this adapter: of this checkpoint, robot, action type and setting. If
    it is another one's, comparisons are wrong.

    ## Example
    `success_rate: 0.92` from the paper, although the released checkpoint was trained for another robot.

    ## Use instead
    What `xpl eval` measures, with enough `episodes`: with 20 the interval is up to 40 % wide.

    ## Fix safety
    No automatic fix.
    """
    claimed = claimed_rates(simulation)
    if not claimed:
        measure(simulation, simulation.first, simulation.probe.options.episodes or USUAL_EPISODES)
        raise NotApplicable(f"the manifest claims no success rate in {ENVIRONMENT}")
    for claim in claimed:
        figure = measure(simulation, claim.setup, claim.episodes)
        interval = figure.success_interval
        if claim.success_rate not in interval:
            other = "higher" if claim.success_rate > interval.high else "lower"
            yield Finding(
                f"the manifest claims {claim.success_rate:.0%} success in {claim.setup}, {other} than the "
                "measured rate",
                path=spec.File.POLICY_YML,
                expected=f"a rate within {interval}, as {figure.successes} of {figure.episodes} episodes succeed",
                got=f"{claim.success_rate:.0%}",
                evidence=figure.as_json(),
                fix=Fix("advice", "claim what was measured with this adapter, or find out why it no longer reaches it"),
            )
