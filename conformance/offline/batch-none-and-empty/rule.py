"""XPL204: None and the empty list are confused."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.served.compare import brief, difference, is_answer_list, raised, same
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.recorded_client import Answer
from xpl_cli.basics.phrases import count_noun


@rule(code="XPL204", requirement="XPL-BAT-2", tries="empty batches and unknown environments")
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
    probe.require_chunks(listed, envs)
    is_empty = not raised(empty) and hasattr(empty, "__len__") and len(empty) == 0
    if not is_empty:
        ended = "all of its environments have ended"
        yield blame(
            f"get_action_batch([]) raises {raised(empty)}: an evaluation stops when {ended}"
            if raised(empty)
            else f"get_action_batch([]) does not return []: a second get_action_batch on one batch works when {ended}",
            expected="[]",
            got=raised(empty) or brief(empty),
            fix=Fix("advice", "test `env_idx_list is None`; `env_idx_list or default` treats an empty list as missing"),
        )
    mismatch = difference(listed, implied)
    if mismatch is not None:
        yield blame(
            f"get_action_batch(None) {_describe(implied, listed, envs)}",
            expected=f"the answer for {envs}",
            got=raised(implied) or mismatch,
            fix=Fix("advice", "remember the order of the last update_obs_batch and use it for None"),
        )
    elif is_empty and same(*listed):
        raise NotApplicable("both environments get the same actions: whether None keeps their order cannot be seen")


def _describe(implied: Answer, listed: Answer, envs: Sequence[int]) -> str:
    """Return what is wrong with an answer for all environments, and what follows."""
    if raised(implied):
        return f"raises {raised(implied)}: a client that lists no environments gets no action"
    if not isinstance(implied, (list, tuple)) or len(implied) != len(envs):
        count = count_noun(len(implied), "chunk") if isinstance(implied, (list, tuple)) else brief(implied)
        return f"answers {count} for {len(envs)} observed environments: robots get no command, or one of another"
    if is_answer_list(listed, len(envs)) and all(any(same(chunk, other) for other in listed) for chunk in implied):
        return "does not follow the order of the last batch: robots receive each other's commands"
    return f"gives other actions than get_action_batch({envs}): they depend on the form of a call"
