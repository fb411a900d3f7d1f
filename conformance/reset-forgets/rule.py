"""XPL208: An episode depends on the one before it."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.compare import difference
from xpl_cli.audit.probe import Probe, blame


@rule(code="XPL208", slug="reset-forgets", gate="offline", requirement="XPL-EPI-1")
def reset_forgets(probe: Probe) -> Iterator[Finding]:
    """An episode depends on the one before it.

    ## What it does
    In two fresh servers, plays two different first episodes, of other length and content, and then the same second
    one, and compares the second episodes. A policy that seeds each episode by its number passes.

    ## Why it matters
    The first episode of a run is then the only comparable one; success rates depend on the order of the tasks.

    ## Example
    reset clears the observation buffer and forgets the queue of the actions still to be executed.

    ## Use instead
    Keep all episode state in the base class, or clear it in `reset_env`, which is called for every environment.

    ## Fix safety
    No automatic fix.
    """
    probe.ready()
    probe.require_deterministic()
    second_episodes = []
    for env, steps in ((0, 1), (2, 4)):  # two different first episodes, then the same second one
        with probe.fresh_session() as policy:
            probe.episode(policy, env=env, steps=steps)
            second_episodes.append(probe.episode(policy, env=1))
    found = difference(*second_episodes)
    if found is not None:
        yield blame(
            "an episode depends on the one before it: reset leaves something behind",
            expected="equal actions after different first episodes",
            got=found,
            fix=Fix("advice", "clear every buffer, cache, counter and chunk queue in reset"),
        )
