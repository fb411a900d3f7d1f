"""XPL408: Equal seeds give equal episodes."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, rule
from xpl_cli.audit.environments.stage import Offer, Stage
from xpl_cli.audit.environments.trial import difference

SEED = 3


@rule(code="XPL408", gate="offline", requirement="XPL-ENV-4", after=("env-plays",))
def env_same_seed(stage: Stage) -> Iterator[Finding]:
    """The same seed and the same actions do not give the same episode.

    ## What it does
    Plays the same short episode of each task twice, that of the first task in two new processes, and compares all
    observations, pictures included where there are any, and the results, bit by bit. A robot repeats nothing: there the
    rule does not apply.

    ## Why it matters
    Who cannot play an episode again cannot tell a better policy from luck, and cannot find out what went wrong in one.

    ## Example
    The layout is drawn from numpy's global generator, which nobody seeded.

    ## Use instead
    Make one generator from the seed in `reset`, and draw everything from that one.

    ## Fix safety
    No automatic fix.
    """
    stage.require_repeats()
    for offer in stage.tasks[:1]:
        yield from stage.told(_repeated(stage, offer, fresh=True), f"{offer} can be played twice")
    for offer in stage.tasks[1:]:
        yield from stage.told(_repeated(stage, offer, fresh=False), f"{offer} can be played twice")


def _repeated(stage: Stage, offer: Offer, *, fresh: bool) -> Iterator[Finding]:
    first, second = (stage.trial(offer, SEED, fresh=fresh, cameras=stage.cameras)[0] for _ in range(2))
    where = difference(first, second)
    if where is not None:
        yield stage.finding(
            f"{offer}: seed {SEED} gave two episodes that differ {where}",
            expected="the same episode",
            got=where,
            advice="draw everything that varies from one generator made from the seed",
        )
