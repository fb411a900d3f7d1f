"""XPL408: Equal seeds give equal episodes."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, rule
from xpl_cli.audit.environments.env_probe import EnvProbe, Offer
from xpl_cli.audit.environments.observed_episode import difference

SEED = 3


@rule(code="XPL408", gate="offline", requirement="XPL-ENV-4", after=("env-runs",), tries="equal seeds")
def env_same_seed(env_probe: EnvProbe) -> Iterator[Finding]:
    """The same seed and the same actions do not give the same episode.

    ## What it does
    Runs the same short episode of each task twice, that of the first task in two new processes, and compares all
    observations, images included if there are any, and the results, bit by bit. It does not apply to a robot, whose
    episodes are not repeatable.

    ## Why it matters
    Without repeatable episodes a better policy cannot be distinguished from luck, and a failure cannot be debugged.

    ## Example
    The layout is drawn from numpy's global generator, which is not seeded.

    ## Use instead
    Create one generator from the seed in `reset`, and draw everything from it.

    ## Fix safety
    No automatic fix.
    """
    env_probe.require_repeats()
    for offer in env_probe.tasks[:1]:
        yield from env_probe.report_failure(_repeated(env_probe, offer, fresh=True), f"{offer} can run twice")
    for offer in env_probe.tasks[1:]:
        yield from env_probe.report_failure(_repeated(env_probe, offer, fresh=False), f"{offer} can run twice")


def _repeated(env_probe: EnvProbe, offer: Offer, *, fresh: bool) -> Iterator[Finding]:
    first, second = (env_probe.run_episodes(offer, SEED, fresh=fresh, cameras=env_probe.cameras)[0] for _ in range(2))
    where = difference(first, second)
    if where is not None:
        yield env_probe.finding(
            f"{offer}: seed {SEED} gave two episodes that differ {where}",
            expected="the same episode",
            got=where,
            advice="draw everything that varies from one generator made from the seed",
        )
