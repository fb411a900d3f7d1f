"""XPL410: A reset clears all state of the previous episode."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, rule
from xpl_cli.audit.environments.env_probe import STEPS, EnvProbe, Offer
from xpl_cli.audit.environments.observed_episode import difference

SEED = 3


@rule(code="XPL410", gate="offline", requirement="XPL-ENV-9", after=("env-runs",), tries="resets")
def env_reset(env_probe: EnvProbe) -> Iterator[Finding]:
    """An episode depends on the previous one.

    ## What it does
    Runs a seed, another seed that is interrupted in the middle, and the first one again in the same environment; the
    first and the last episode have to be equal. It does not apply to a robot, whose episodes are not repeatable.

    ## Why it matters
    Episodes that depend on their order cannot be repeated one by one, nor distributed over several machines.

    ## Example
    The simulator keeps the velocities of the previous episode.

    ## Use instead
    Restore every part of the simulator's state in `reset`, counters and filters too.

    ## Fix safety
    No automatic fix.
    """
    env_probe.require_repeats()
    for offer in env_probe.tasks:
        yield from env_probe.report_failure(_again(env_probe, offer), f"three episodes of {offer} can run")


def _again(env_probe: EnvProbe, offer: Offer) -> Iterator[Finding]:
    with env_probe.make_env(offer, **env_probe.privileged_config) as play:
        (first,) = play.run_motion(offer, SEED)
        play.run_motion(offer, SEED + 1, steps=STEPS // 2)
        (last,) = play.run_motion(offer, SEED)
    where = difference(first, last)
    if where is not None:
        yield env_probe.finding(
            f"{offer}: seed {SEED} gives another episode after one of seed {SEED + 1}: {where}",
            expected="the same episode, whatever the previous one was",
            got=where,
            advice="restore all of the state in reset",
        )
