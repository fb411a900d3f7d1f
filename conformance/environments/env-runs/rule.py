"""XPL404: Everything that env.yml declares can run."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from xpl_cli.audit import Finding, NotRun, rule
from xpl_cli.audit.environments.env_probe import EnvProbe, Offer, motion


@rule(code="XPL404", gate="offline", requirement="XPL-ENV-6", tries="every task and robot")
def env_runs(env_probe: EnvProbe) -> Iterator[Finding]:
    """The environment cannot be created, reset or stepped in a combination that env.yml declares.

    ## What it does
    Creates the environment in a separate process, for every task and for every robot with every action type, resets it
    and executes a step that holds the pose.

    ## Why it matters
    Evaluations are planned with env.yml. A combination that is declared but does not run is noticed hours later, on
    another machine.

    ## Example
    A robot is added to env.yml, but the simulator has no start pose for it.

    ## Use instead
    Remove it from env.yml, or list in `unsupported` with which robots a task does not run, and why.

    ## Fix safety
    No automatic fix.
    """
    for offer in env_probe.robots:
        yield from env_probe.report_failure(_played(env_probe, offer), f"{offer} can run")


def _played(env_probe: EnvProbe, offer: Offer) -> Iterator[Finding]:
    with env_probe.make_env(offer) as play:
        play.reset(0)
        observations = play.observe()
        if len(observations) != 1 or not isinstance(observations[0], dict):
            got = f"{len(observations)} observations"
            yield env_probe.finding(
                f"{offer}: after a reset one environment returns {got}",
                expected="one observation, a map",
                got=got,
                advice="return one observation for each requested environment",
            )
            return
        with contextlib.suppress(NotRun):  # a state that no motion can begin from is what env-observations reports
            play.act({0: motion(offer, observations[0], 0)})
        play.results()
