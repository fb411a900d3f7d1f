"""XPL207: Environments of one batch influence each other."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.offline.in_process_run import InProcessRun
from xpl_cli.audit.served.compare import first_step, is_answer_list
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL207", requirement="XPL-BAT-5", compares=True, tries="batches in other orders and sizes")
def batch_independent(probe: Probe, in_process_run: InProcessRun) -> Iterator[Finding]:
    """Environments of one batch influence each other.

    ## What it does
    Runs three environments with one instruction in one batch for three steps, then each of them alone, and compares the
    actions. Floating-point error that depends on the batch size is allowed: if actions differ, equal observations are
    sent in batches of one to four, and five times the differences of one environment's actions is allowed, at most 2 %
    of the range of all actions or half a percent of the largest number.

    ## Why it matters
    A shared history, cache, step counter or random generator makes results depend on how many environments run in
    parallel. Such results cannot be reproduced with another batch size.

    ## Example
    One action queue for all environments: environment 1 continues the chunk of environment 0.

    ## Use instead
    `xpl.Policy` keeps history and generators per environment; store state of a library in a dict keyed by environment.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    envs = [0, 1, 2]
    # All with one instruction: whether each follows its own, `instruction-per-environment` asks.
    instruction = probe.observation()[spec.Obs.INSTRUCTION]
    together = probe.batch_episode(envs, instruction=instruction)
    probe.require_chunks(together[0], envs)
    for env in envs:
        by_itself = probe.batch_episode([env], instruction=instruction)
        for step, (alone, batch) in enumerate(zip(by_itself, together, strict=True)):
            mismatch = probe.batch_difference(alone, batch[env : env + 1] if is_answer_list(batch) else batch)
            if mismatch is not None:
                in_process_run.require_no_draws(probe, of_batches=True)
                yield blame(
                    f"environment {env} acts differently in a batch than alone, from step {step} on: state is "
                    "shared, and results depend on how many run at once",
                    expected="the actions of a run alone",
                    got=mismatch,
                    evidence={
                        "environment": env,
                        "step": step,
                        "alone": first_step(alone[0]) if is_answer_list(alone) else None,
                    },
                    fix=Fix("advice", "keep history, caches, counters and generators per environment index"),
                )
                return
