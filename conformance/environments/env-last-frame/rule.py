"""XPL414: last_frame repeats the last observation."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, rule
from xpl_cli.audit.environments.env_probe import EnvProbe, Offer, motion
from xpl_cli.audit.environments.observed_episode import ObservedEpisode, difference


@rule(code="XPL414", gate="offline", requirement="XPL-ENV-14", after=("env-runs",), tries="the last frame")
def env_last_frame(env_probe: EnvProbe) -> Iterator[Finding]:
    """`get_obs_batch(last_frame=True)` does not return the previous observation.

    ## What it does
    Observes, and observes again with `last_frame`, after a reset and after a step.

    ## Why it matters
    Some evaluation loops request the last frame after acting, when they need no new image; some expect it to be the
    policy's latest observation.

    ## Example
    The environment ignores `last_frame`, and a camera with noise returns another image.

    ## Use instead
    `xpl.environment.Environment`, which implements this for an author's `Episode`.

    ## Fix safety
    No automatic fix.
    """
    for offer in env_probe.tasks[:1]:
        yield from env_probe.report_failure(_repeated(env_probe, offer), f"{offer} can be observed")


def _repeated(env_probe: EnvProbe, offer: Offer) -> Iterator[Finding]:
    with env_probe.make_env(offer, cameras=env_probe.cameras) as play:
        play.reset(0)
        (first,) = play.observe()
        for step in range(2):
            (last,) = play.observe()
            (again,) = play.call("get_obs_batch", [0], True)  # noqa: FBT003 - as benchmarks pass it
            where = difference(ObservedEpisode((last,), {}), ObservedEpisode((again,), {}))
            if where is not None:
                yield env_probe.finding(
                    f"{offer}: with last_frame the observation differs, {where}",
                    expected="the last observation",
                    got=where,
                    advice="keep each environment's last observation",
                )
                return
            play.act({0: motion(offer, first, step)})
