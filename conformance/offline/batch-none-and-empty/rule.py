"""XPL204: None and the empty list are confused."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.served.compare import brief, difference, error_code
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL204", requirement="XPL-BAT-2")
def batch_none_and_empty(probe: Probe) -> Iterator[Finding]:
    """None and the empty list are confused.

    ## What it does
    Requests `[]`, which must return `[]`, and `None`, which means the environments of the last batch in their order.

    ## Why it matters
    When the last environment of a batch ends, the list is empty. An adapter that treats it as "all" acts on finished
    episodes, and the actions after it go to the wrong environments.

    ## Example
    `envs = env_idx_list or self.all_envs`

    ## Use instead
    `envs = self.order if env_idx_list is None else env_idx_list`

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    envs = [4, 2]
    batch = probe.observations(envs)
    listed, implied, empty = (probe.batch_answer(batch, indices) for indices in (envs, None, []))
    if error_code(empty) or not hasattr(empty, "__len__") or len(empty) != 0:
        follows = "an evaluation stops" if error_code(empty) else "a second get_action_batch on one batch works"
        yield blame(
            f"get_action_batch([]) does not return []: {follows} when all of its environments have ended",
            expected="[]",
            got=brief(empty),
            fix=Fix("advice", "test `env_idx_list is None`; `env_idx_list or default` treats an empty list as missing"),
        )
    mismatch = difference(listed, implied)
    if mismatch is not None:
        yield blame(
            "get_action_batch(None) does not follow the order of the last batch: robots receive each other's commands",
            expected=f"the answer for {envs}",
            got=mismatch,
            fix=Fix("advice", "remember the order of the last update_obs_batch and use it for None"),
        )
