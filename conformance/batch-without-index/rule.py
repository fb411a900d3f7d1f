"""XPL206: Observations without env_idx are mixed up or refused."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.compare import difference
from xpl_cli.audit.probe import Probe, blame


@rule(code="XPL206", slug="batch-without-index", gate="offline", requirement="XPL-BAT-4")
def batch_without_index(probe: Probe) -> Iterator[Finding]:
    """Observations without env_idx are mixed up or refused.

    ## What it does
    Shows the same two observations with and without `env_idx` and compares the answers.

    ## Why it matters
    `env_idx` is optional. Clients that leave it out, and there are some in the field, would see every robot receive the
    actions of the last one, or an exception.

    ## Example
    `self.obs[obs.get("env_idx", 0)] = obs` inside the loop over the batch stores all of them under 0.

    ## Use instead
    `xpl.observation.env_indices(batch)`

    ## Fix safety
    No automatic fix.
    """
    probe.ready()
    named = probe.observations([0, 1])
    bare = [{key: value for key, value in obs.items() if key != spec.Obs.ENV_IDX} for obs in named]
    found = difference(probe.batch_answer(named, [0, 1]), probe.batch_answer(bare, [0, 1]))
    if found is not None:
        yield blame(
            "observations without env_idx are not told apart by their position: one environment overwrites another",
            expected="the same actions as with env_idx 0 and 1",
            got=found,
            fix=Fix("advice", "number the observations of a batch by position if all of them lack env_idx"),
        )
