"""XPL414: last_frame repeats the last observation."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, rule
from xpl_cli.audit.environments.stage import Offer, Stage, motion
from xpl_cli.audit.environments.trial import Trial, difference


@rule(code="XPL414", gate="offline", requirement="XPL-ENV-14", after=("env-runs",))
def env_last_frame(stage: Stage) -> Iterator[Finding]:
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
    for offer in stage.tasks[:1]:
        yield from stage.told(_repeated(stage, offer), f"{offer} can be observed")


def _repeated(stage: Stage, offer: Offer) -> Iterator[Finding]:
    with stage.play(offer, cameras=stage.cameras) as play:
        play.reset(0)
        (first,) = play.observe()
        for step in range(2):
            (seen,) = play.observe()
            (again,) = play.call("get_obs_batch", [0], True)  # noqa: FBT003 - as benchmarks pass it
            where = difference(Trial((seen,), {}), Trial((again,), {}))
            if where is not None:
                yield stage.finding(
                    f"{offer}: with last_frame the observation differs, {where}",
                    expected="the last observation",
                    got=where,
                    advice="keep each environment's last observation",
                )
                return
            play.act({0: motion(offer, first, step)})
