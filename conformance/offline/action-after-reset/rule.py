"""XPL209: After reset the adapter still returns actions of the previous episode."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.served.compare import brief, error_code
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL209", requirement="XPL-EPI-3", tries="resets", handler=spec.Method.RESET)
def action_after_reset(probe: Probe) -> Iterator[Finding]:
    """After reset the adapter still returns actions of the previous episode.

    ## What it does
    Sends an observation, resets, and calls `get_action` without a new observation; once for one environment, once for a
    batch.

    ## Why it matters
    A client that calls `get_action` too early would move the robot by an observation of another episode. It must get an
    error instead.

    ## Example
    reset clears the action queue but not `self.obs`.

    ## Use instead
    Clear the observations in reset, or derive from `xpl.Policy`.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    obs = probe.observation()
    with probe.session() as policy:
        policy.act(obs)
        policy.reset()
        single = policy.get_action()
        policy.reset()
        policy.update_obs_batch(probe.observations([3, 7]))
        policy.reset()
        batch = policy.get_action_batch([3])
    for operation, answer in (("get_action()", single), ("get_action_batch([3])", batch)):
        if error_code(answer) is None:
            yield blame(
                f"{operation} right after reset uses the previous episode's observation: the first command of "
                "an episode belongs to another scene",
                expected="an error: no observation since the last reset",
                got=brief(answer),
                fix=Fix("advice", "clear the observations in reset and raise an error while there is none"),
            )
