"""XPL203: A batch returns actions of other environments than the requested ones."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.in_process_run import InProcessRun
from xpl_cli.audit.served.compare import (
    brief,
    describe_wrong_batch,
    error_code,
    first_step,
    is_answer_list,
    same,
)
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.recorded_client import Answer


@rule(code="XPL203", requirement="XPL-BAT-1", compares=True, tries="batches in other orders and sizes")
def batch_order(probe: Probe, in_process_run: InProcessRun) -> Iterator[Finding]:
    """A batch returns actions of other environments than the requested ones.

    ## What it does
    Sends observations of environments 3, 7 and 9, then requests [9], [9, 3] and [7, 9, 3] and compares each action with
    the previous one of that environment, up to batch-size-dependent floating-point error (XPL207).

    ## Why it matters
    In batched evaluation environments finish at different times. An adapter that indexes by position sends the commands
    of one robot to another; nothing crashes, but the success rate drops.

    ## Example
    `get_action_batch([9])` that computes `self.obs[: len(env_idx_list)]` returns the action of environment 3.

    ## Use instead
    Derive from `xpl.Policy`, or keep observations in a dict keyed by environment index.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    envs = [3, 7, 9]
    batch = probe.observations(envs)
    whole = probe.batch_answer(batch, envs)
    if not is_answer_list(whole, len(envs)):
        failed = error_code(whole) is not None
        yield blame(
            f"get_action_batch({envs}) fails: no environment of a batched evaluation gets a command"
            if failed
            else (
                f"get_action_batch({envs}) does not return one chunk per environment: robots get no command, or "
                "that of another one"
            ),
            expected=f"{len(envs)} chunks",
            got=textwrap.shorten(str(whole), 200) if failed else brief(whole),
            fix=Fix("advice", "return one chunk per entry of env_idx_list"),
        )
        return
    alone = dict(zip(envs, whole, strict=True))
    for indices in ([9], [9, 3], [7, 9, 3]):
        answer = probe.batch_answer(batch, indices)
        mismatch = probe.batch_difference([alone[env] for env in indices], answer)
        if mismatch is not None:
            if not _is_of_others(answer, alone, indices):
                in_process_run.require_no_draws(probe, of_batches=True)
            yield blame(
                f"get_action_batch({indices}) {describe_wrong_batch(answer, alone, indices)}",
                expected=f"the chunks of environments {indices}, in this order",
                got=mismatch,
                evidence={
                    "observed": envs,
                    "asked": indices,
                    "first_action": first_step(answer[0]) if is_answer_list(answer) else None,
                },
                fix=Fix("advice", "look observations up by environment index, never by position in the list"),
            )
            return
    alike = next((pair for pair in combinations(envs, 2) if same(*(alone[env] for env in pair))), None)
    if alike is not None:
        raise NotApplicable(f"environments {alike[0]} and {alike[1]} get the same actions: their order cannot be seen")


def _is_of_others(answer: Answer, alone: Mapping[int, Answer], indices: Sequence[int]) -> bool:
    """Tell whether a batch holds, exactly, what other environments than the requested ones get."""
    chunks = answer if is_answer_list(answer) else []
    answered = zip(chunks, indices, strict=False)
    return any(same(chunk, alone[env]) for chunk, wanted in answered for env in alone if env != wanted)
