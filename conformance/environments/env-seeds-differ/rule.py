"""XPL409: Different seeds give different episodes."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, NotApplicable, rule
from xpl_cli.audit.environments.env_probe import EnvProbe, Offer
from xpl_cli.audit.environments.observed_episode import difference

SEEDS = (0, 1, 2, 3)


@rule(code="XPL409", gate="offline", requirement="XPL-ENV-8", after=("env-runs",), tries="other seeds")
def env_seeds_differ(env_probe: EnvProbe) -> Iterator[Finding]:
    """All seeds give the same episode.

    ## What it does
    Runs each task with four seeds and the same motion. At least one episode has to differ from the first; simulator
    ground truth is compared, too, if the environment provides it. It does not apply to a robot, whose scene people
    arrange.

    ## Why it matters
    A hundred episodes are then one episode, counted a hundred times.

    ## Example
    `reset` ignores the seed.

    ## Use instead
    Vary what a policy should cope with: positions, orientations, colours. An environment that follows a script on
    purpose declares `scripted: true` in env.yml.

    ## Fix safety
    No automatic fix.
    """
    env_probe.require_repeats()
    if env_probe.manifest.scripted:
        raise NotApplicable("env.yml declares that observations follow a script")
    for offer in env_probe.tasks:
        yield from env_probe.report_failure(_varied(env_probe, offer), f"{offer} can run")


def _varied(env_probe: EnvProbe, offer: Offer) -> Iterator[Finding]:
    with env_probe.make_env(offer, **env_probe.privileged_config) as play:
        trials = [play.run_motion(offer, seed, steps=1)[0] for seed in SEEDS]
    if all(difference(trials[0], other) is None for other in trials[1:]):
        yield env_probe.finding(
            f"{offer}: seeds {', '.join(map(str, SEEDS))} all give the same episode",
            expected="episodes that differ",
            got="no difference",
            advice="let the seed decide what varies, or declare scripted: true",
        )
