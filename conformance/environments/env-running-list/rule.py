"""XPL407: An environment that has ended leaves the running list."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from xpl.simulator.process import EnvRaisedError
from xpl_cli.audit import Finding, rule
from xpl_cli.audit.environments.env_probe import EnvProbe, Offer, motion
from xpl_cli.audit.environments.observed_episode import ObservedEpisode, difference

LIMIT = 4


@rule(
    code="XPL407",
    gate="offline",
    requirement="XPL-ENV-7",
    after=("env-runs",),
    tries="the list of running environments",
)
def env_running_list(env_probe: EnvProbe) -> Iterator[Finding]:
    """An environment whose episode has ended stays in the running list, or still moves.

    ## What it does
    Ends one of two episodes by an action that is NaN, or both by their step limit, and then acts on the ended ones
    again. It does not apply to a robot, or to an environment without batches.

    ## Why it matters
    Benchmarks loop while the running list is not empty, and send actions to its environments. If the list never
    shrinks, the evaluation never ends; an ended environment that moves changes its result.

    ## Example
    `get_running_env_idx_list` returns all indices as long as one of them is running.

    ## Use instead
    `xpl.environment.Environment`, which implements this for an author's `Episode`.

    ## Fix safety
    No automatic fix.
    """
    for offer in env_probe.tasks:
        yield from env_probe.report_failure(_shrinks(env_probe, offer), f"two episodes of {offer} can run")


def _shrinks(env_probe: EnvProbe, offer: Offer) -> Iterator[Finding]:
    envs = [0] if env_probe.is_real else [0, 1]
    with env_probe.make_env(offer, num_envs=len(envs), max_steps=LIMIT) as play:
        play.reset(*envs)
        first = play.observe()
        before = play.running()
        if before != envs:
            yield _wrong(env_probe, f"{offer}: after a reset the running list is {before}", str(envs), str(before))
        for step in range(LIMIT):
            running = play.running()
            if running:
                play.act({env: motion(offer, first[env], step) for env in running})
        after, results = play.running(), play.results()
        if after:
            text = f"{offer}: the step limit is {LIMIT}, and after it the running list is still {after}"
            yield _wrong(env_probe, text, "[]", str(after))
            return
        final = play.observe(*envs)
        # Refusing an action that comes too late is as good as ignoring it.
        with contextlib.suppress(EnvRaisedError):
            play.act({env: motion(offer, first[env], LIMIT) for env in envs})
        late = ObservedEpisode(tuple(play.observe(*envs)), {}), ObservedEpisode(tuple(final), {})
        moved = difference(*late, env_probe.rest_tolerance)
        if moved is not None or play.results() != results:
            text = f"{offer}: an action after the end still changes the environment ({moved or 'its result'})"
            yield _wrong(env_probe, text, "nothing to change", moved or "another result")


def _wrong(env_probe: EnvProbe, text: str, expected: str, got: str) -> Finding:
    return env_probe.finding(
        text, expected=expected, got=got, advice="remove ended environments from the list, and do not step them"
    )
