"""XPL205: An unknown or repeated environment gets an action instead of an error."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.served.compare import brief, error_code
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL205", requirement="XPL-BAT-3")
def batch_unknown(probe: Probe) -> Iterator[Finding]:
    """An unknown or repeated environment gets an action instead of an error.

    ## What it does
    Observes environments 3 and 7, then requests [3, 8] and [3, 3]. Both must be errors.

    ## Why it matters
    The action can only come from another environment's observation. An off-by-one error of a launcher then goes
    unnoticed.

    ## Example
    `obs = self.obs.get(env, self.last_obs)`

    ## Use instead
    `obs = self.obs[env]`, which raises a KeyError, or `xpl.Policy`, whose error lists the known environments.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    for indices, what in (([3, 8], "environment 8, which was never observed"), ([3, 3], "environment 3 twice")):
        with probe.session() as policy:
            policy.reset()
            policy.update_obs_batch(probe.observations([3, 7]))
            answer = policy.get_action_batch(indices)
        if error_code(answer) is None:
            yield blame(
                f"for {what} the adapter returns an action instead of an error",
                expected="an error that names the environment",
                got=brief(answer),
                fix=Fix(
                    "advice", "raise an error for an environment index without an observation, and for a repeated one"
                ),
            )
