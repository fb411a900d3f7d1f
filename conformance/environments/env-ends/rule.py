"""XPL406: Episodes end at their step limit, with one result each."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, rule
from xpl_cli.audit.environments.env_probe import EnvProbe, Offer

LIMIT, SEED = 5, 3


@rule(code="XPL406", gate="offline", requirement="XPL-ENV-13", after=("env-runs",), tries="ends of episodes")
def env_ends(env_probe: EnvProbe) -> Iterator[Finding]:
    """An episode continues beyond its step limit, or has no valid result.

    ## What it does
    Runs an episode of five control steps in each task, counts its steps, and reads the result: success, score from 0 to
    1, steps, seed and the reason of its end. Compares the step limits of env.yml with the one that is applied.

    ## Why it matters
    An evaluation waits for the end of an episode, and averages scores. A wrong number of steps or a score above 1 ends
    up in published results.

    ## Example
    The environment ignores `max_steps` of the configuration, and each episode takes as many steps as env.yml says.

    ## Use instead
    `xpl.environment.Environment`, which implements this for an author's `Episode`.

    ## Fix safety
    No automatic fix.
    """
    for offer in env_probe.tasks:
        yield from env_probe.report_failure(_ended(env_probe, offer), f"an episode of {offer} can run")


def _ended(env_probe: EnvProbe, offer: Offer) -> Iterator[Finding]:
    with env_probe.make_env(offer, max_steps=LIMIT) as play:
        (trial,) = play.run_motion(offer, SEED, steps=LIMIT + 2)
        running, over = play.running(), play.call("is_episode_end")
    steps, result = len(trial.observations) - 1, trial.result
    for wrong, expected, got in (
        (steps > LIMIT or running, f"an end after {LIMIT} control steps", f"{steps} steps, running: {running}"),
        (over is not True, "is_episode_end() to be True then", repr(over)),
        (result.get("steps") != steps, f"a result of {steps} steps", f"steps: {result.get('steps')!r}"),
        (result.get(sdk.Deploy.SEED) != SEED, f"a result of seed {SEED}", f"{result.get(sdk.Deploy.SEED)!r}"),
        (
            result.get("success") not in (True, False, None),
            "success: true, false or null",
            f"{result.get('success')!r}",
        ),
        (not _is_score(result.get("score")), "score: 0 to 1, or null", f"{result.get('score')!r}"),
        (not result.get("end_reason"), "end_reason: why it ended", f"{result.get('end_reason')!r}"),
    ):
        if wrong:
            yield env_probe.finding(
                f"{offer}: expected {expected}, got {got}",
                expected=expected,
                got=got,
                advice="see envs/offline/client.py",
            )


def _is_score(value: object) -> bool:
    return value is None or (isinstance(value, (int, float)) and 0 <= value <= 1)
