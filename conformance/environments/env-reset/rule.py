"""XPL410: A reset leaves nothing of the episode before."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, rule
from xpl_cli.audit.environments.stage import STEPS, Offer, Stage
from xpl_cli.audit.environments.trial import difference

SEED = 3


@rule(code="XPL410", gate="offline", requirement="XPL-ENV-9", after=("env-plays",))
def env_reset(stage: Stage) -> Iterator[Finding]:
    """An episode depends on the one before it.

    ## What it does
    Plays a seed, another seed that is broken off in the middle, and the first one again in the same environment; the
    first and the last have to be equal. A robot repeats nothing: there the rule does not apply.

    ## Why it matters
    Episodes that depend on their order cannot be repeated one by one, nor shared out to several machines.

    ## Example
    The simulator keeps the velocities of the episode before.

    ## Use instead
    Put every part of the simulator's state back in `reset`, counters and filters too.

    ## Fix safety
    No automatic fix.
    """
    stage.require_repeats()
    for offer in stage.tasks:
        yield from stage.told(_again(stage, offer), f"three episodes of {offer} can be played")


def _again(stage: Stage, offer: Offer) -> Iterator[Finding]:
    with stage.play(offer, **stage.truth) as play:
        (first,) = play.trial(offer, SEED)
        play.trial(offer, SEED + 1, steps=STEPS // 2)
        (last,) = play.trial(offer, SEED)
    where = difference(first, last)
    if where is not None:
        yield stage.finding(
            f"{offer}: seed {SEED} gives another episode after one of seed {SEED + 1}: {where}",
            expected="the same episode, whatever came before",
            got=where,
            advice="put all of the state back in reset",
        )
