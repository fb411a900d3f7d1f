"""XPL415: Observations contain simulator ground truth only on request."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, rule
from xpl_cli.audit.environments.env_probe import EnvProbe, Offer


@rule(code="XPL415", gate="offline", requirement="XPL-ENV-15", after=("env-runs",), tries="simulator ground truth")
def env_privileged(env_probe: EnvProbe) -> Iterator[Finding]:
    """Observations contain simulator ground truth that was not requested, or lack what env.yml declares.

    ## What it does
    Observes with and without `privileged` in the configuration, as far as env.yml declares that the environment can
    provide the ground truth.

    ## Why it matters
    An evaluation of a policy that gets object poses does not measure perception. It goes unnoticed: the success rate is
    high.

    ## Example
    `privileged` is always in the observation, since most policies ignore it.

    ## Use instead
    `xpl.environment.Environment`, which implements this for an author's `Episode`.

    ## Fix safety
    No automatic fix.
    """
    offer = env_probe.offers[0]
    yield from env_probe.report_failure(_shown(env_probe, offer), f"{offer} can be observed")


def _shown(env_probe: EnvProbe, offer: Offer) -> Iterator[Finding]:
    with env_probe.make_env(offer, **{sdk.Obs.PRIVILEGED: False}) as play:
        play.reset(0)
        if sdk.Obs.PRIVILEGED in play.observe()[0]:
            yield env_probe.finding(
                f"{offer}: observations contain ground truth that was not requested",
                expected=f"no {sdk.Obs.PRIVILEGED}",
                got=f"{sdk.Obs.PRIVILEGED} in the observation",
                advice="add it only if the configuration requests it",
            )
    if not env_probe.manifest.privileged:
        return
    with env_probe.make_env(offer, **{sdk.Obs.PRIVILEGED: True}) as play:
        play.reset(0)
        if not play.observe()[0].get(sdk.Obs.PRIVILEGED):
            yield env_probe.finding(
                f"{offer}: env.yml declares ground truth, and observations lack it when it is requested",
                expected=f"{sdk.Obs.PRIVILEGED} in the observation",
                got="nothing",
                advice=f"return it, or declare {sdk.Obs.PRIVILEGED}: false",
            )
