"""XPL210: A second reset changes the episode."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.served.compare import brief, difference, error_code
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL210", requirement="XPL-EPI-2", compares=True, tries="resets", handler=spec.Method.RESET)
def reset_twice(probe: Probe) -> Iterator[Finding]:
    """A second reset changes the episode.

    ## What it does
    Compares the first action after one reset with the first action after two, each in a fresh server.

    ## Why it matters
    Some benchmark clients reset before and inside the evaluation loop. If seeds or episode counters advance with reset,
    results of two benchmarks differ that should be equal.

    ## Example
    `self.episode += 1` in reset, with a seed that depends on it.

    ## Use instead
    `self.rng(env)` of `xpl.Policy`, whose episode index advances only if an observation arrived.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    probe.require_deterministic()
    obs = probe.observation()
    with probe.fresh_session() as policy:
        first = policy.reset()
        once = (policy.update_obs(obs), policy.get_action())[1]
    with probe.fresh_session() as policy:
        policy.reset()
        second = policy.reset()
        twice = (policy.update_obs(obs), policy.get_action())[1]
    for answer, which in ((first, "the first"), (second, "a second")):
        if error_code(answer) is not None:
            yield blame(f"{which} reset raises an error", expected="no error", got=brief(answer))
            return
    mismatch = difference(once, twice)
    if mismatch is not None:
        probe.require_repeatable_afresh()
        yield blame(
            "resetting twice gives other actions than resetting once: results of clients that reset twice "
            "cannot be compared with others",
            expected="the same actions",
            got=mismatch,
            fix=Fix("advice", "advance episode counters when an observation arrives, not in reset"),
        )
