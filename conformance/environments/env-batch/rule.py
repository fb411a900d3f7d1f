"""XPL411: Environments of a batch are independent of each other."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, rule
from xpl_cli.audit.environments.env_probe import EnvProbe, Offer
from xpl_cli.audit.environments.observed_episode import difference

SEEDS = (3, 8)
TOLERANCE = 1e-5


@rule(code="XPL411", gate="offline", requirement="XPL-ENV-10", after=("env-runs",), tries="batches against single runs")
def env_batch(env_probe: EnvProbe) -> Iterator[Finding]:
    """The episode of an environment depends on the others in its batch.

    ## What it does
    Runs two environments in one batch, and each seed alone. Observations have to agree within 1e-5, except for
    `env_idx`, which has to be right; batched simulators may round differently. It does not apply to a robot, which has
    no batches.

    ## Why it matters
    A success rate would depend on how many environments run at once, and mistakes in their assignment show only in
    batches.

    ## Example
    All environments draw from one generator, one after the other.

    ## Use instead
    `xpl.environment.Environment`, which implements this for an author's `Episode`.

    ## Fix safety
    No automatic fix.
    """
    env_probe.require_repeats()
    for offer in env_probe.tasks:
        yield from env_probe.report_failure(_alike(env_probe, offer), f"two episodes of {offer} can run in one batch")


def _alike(env_probe: EnvProbe, offer: Offer) -> Iterator[Finding]:
    if env_probe.manifest.scripted:  # where the index of an environment may be what makes it another one
        with env_probe.make_env(offer, num_envs=2) as play:
            play.reset(*SEEDS)
            indices = [obs.get(sdk.Obs.ENV_IDX) for obs in play.observe()]
        together = alone = []
    else:
        with env_probe.make_env(offer, num_envs=2, **env_probe.privileged_config) as play:
            together = play.run_motion(offer, *SEEDS)
        indices = [trial.observations[0].get(sdk.Obs.ENV_IDX) for trial in together]
        with env_probe.make_env(offer, **env_probe.privileged_config) as play:
            alone = [play.run_motion(offer, seed)[0] for seed in SEEDS]
    if indices != [0, 1]:
        yield env_probe.finding(
            f"{offer}: the observations of two environments have the indices {indices}",
            expected="[0, 1]",
            got=str(indices),
            advice="put the environment's index into its observations",
        )
    for env, (one, other) in enumerate(zip(together, alone, strict=True)):
        where = difference(one, other, TOLERANCE)
        if where is not None:
            yield env_probe.finding(
                f"{offer}: the episode of environment {env} of two differs from one run alone, {where}",
                expected="the same episode",
                got=where,
                advice="give each environment its own simulator state and its own generator",
            )
