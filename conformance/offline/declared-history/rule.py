"""XPL221: Actions depend on older observations than the manifest declares."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.served.compare import answers, difference, first_step
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL221", requirement="XPL-CFG-9")
def declared_history(probe: Probe) -> Iterator[Finding]:
    """Actions depend on older observations than the manifest declares.

    ## What it does
    Plays two episodes that differ in their first observation only, until that one is older than the history that
    policy.yml declares, and compares the last answers. Policies that declare `kind: memory` or ensembling are left
    out.

    ## Why it matters
    Evaluations that batch, replay or resume a policy rely on the declared history. What looks farther back, for
    example a cache that is filled once, acts on a scene that is gone.

    ## Example
    Image features of the first step are kept for the whole episode.

    ## Use instead
    Declare what the policy sees (`temporal.history`, `kind: memory`), or drop what is older.

    ## Fix safety
    No automatic fix.
    """
    temporal = probe.package.manifest.get("temporal")
    if not temporal:
        raise NotApplicable("no manifest declares a history")
    if temporal.get("kind") == "memory" or temporal.get("ensembling") is not None:
        raise NotApplicable("the manifest declares that earlier observations count for the whole episode or chunk")
    probe.ready()
    history = temporal.get("history") or 1
    last = []
    for first in (2, 3):  # scenes of the first observation
        with probe.run() as policy:
            policy.reset()
            for step in range(history + 1):
                scene = probe.observation(0, step) if step else _as_environment(0, probe.observation(first))
                policy.update_obs(scene)
                answer = policy.get_action()
            last.append(answer)
    found = difference(*last)
    if found is not None:
        yield blame(
            f"the action of step {history} depends on the observation of step 0, although the manifest declares a "
            f"history of {history}: the policy acts on a scene that is gone",
            expected="the same action after another first observation",
            got=found,
            evidence={
                "step": history,
                "declared_history": history,
                "first_actions": [first_step(answer) if answers(answer) else None for answer in last],
            },
            fix=Fix("advice", "forget older observations, or declare the history or memory in policy.yml"),
        )


def _as_environment(env: int, obs: dict[str, Any]) -> dict[str, Any]:
    return {**obs, spec.Obs.ENV_IDX: env}
