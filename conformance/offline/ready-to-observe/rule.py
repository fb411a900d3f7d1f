"""XPL254: A new model fails on an observation before its first reset."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotRun, rule
from xpl_cli.audit.served.compare import brief, error_code
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL254", requirement="XPL-EPI-7", tries="resets")
def ready_to_observe(probe: Probe) -> Iterator[Finding]:
    """A new model fails on an observation before its first reset.

    ## What it does
    Sends an observation to a newly constructed model and calls `get_action`, without a reset before.

    ## Why it matters
    After a restart the first request to a server may be an observation, and tools that try an adapter once start with
    one. Their error is about an attribute, and does not say what is missing.

    ## Example
    `self.queue = deque()` in `reset` only, and `self.queue.append(...)` in `update_obs`.

    ## Use instead
    Call `self.reset()` at the end of the constructor.

    ## Fix safety
    Safe if `reset` needs nothing that is set later.
    """
    probe.require_answer()
    with probe.fresh_session() as policy:
        answer = policy.act_at_once(probe.observation())
        if error_code(answer) is None:
            return
        policy.reset()
        again = policy.act_at_once(probe.observation())
        if error_code(again) is not None:
            raise NotRun(f"in a new server the first observation fails after a reset, too: {again}")
        else:
            yield blame(
                "without a reset before it, the first observation raises an error: a restarted server fails "
                "until a client resets it",
                expected="the same action as after a reset",
                got=brief(answer),
                evidence={"error": str(answer)},
                fix=Fix("advice", "set in the constructor what update_obs needs, for example by calling reset there"),
            )
