"""XPL220: An environment follows the instruction of another one."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, NotRun, rule
from xpl_cli.audit.served.compare import difference, first_step, is_answer_list, same
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.recorded_client import Answer


@rule(
    code="XPL220",
    requirement="XPL-BAT-6",
    after=("batch-order", "batch-independent"),
    tries="an instruction for each environment",
)
def instruction_per_environment(probe: Probe) -> Iterator[Finding]:
    """An environment follows the instruction of another one.

    ## What it does
    Sends observations of two environments that differ only in their instructions, and then changes the instruction of
    one of them. The actions of the other one must not change; and if an instruction affects the first environment, it
    must affect the second.

    ## Why it matters
    In a batch of several tasks every robot then executes the task of the first one. Nothing crashes, and similar tasks
    still succeed.

    ## Example
    `prompt = obs_list[0]["instruction"]` for the whole batch.

    ## Use instead
    Read the instruction in `encode`, which gets one environment at a time.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    scene = probe.observation(0)
    one, other = (probe.observation(env)[spec.Obs.INSTRUCTION] for env in (0, 1))

    def answered(*texts: str) -> list[Answer]:
        batch = [{**scene, spec.Obs.ENV_IDX: env, spec.Obs.INSTRUCTION: text} for env, text in enumerate(texts)]
        chunks = probe.batch_answer(batch, [0, 1])
        if not is_answer_list(chunks, 2):
            raise NotRun("a batch of two environments fails, which rule batch-order reports")
        return list(chunks)

    mixed, swapped, equal = answered(one, other), answered(other, other), answered(one, one)
    if same(mixed, swapped) and same(mixed, equal):
        raise NotApplicable("the instruction does not change the actions")
    evidence = {"texts": [one, other], "environment_1": first_step(mixed[1])}
    mismatch = difference(mixed[1], swapped[1])
    if mismatch is not None:
        yield blame(
            "environment 1 acts differently when only the instruction of environment 0 changes: it gets "
            "another robot's task",
            expected="the same actions, as long as its own instruction is the same",
            got=mismatch,
            evidence={**evidence, "environment_1_after": first_step(swapped[1])},
            fix=Fix("advice", "condition each environment on the instruction of its own observation"),
        )
    elif same(mixed[1], equal[1]):
        yield blame(
            "the instruction affects environment 0 but not environment 1: the others of a batch ignore their own task",
            expected="other actions for another instruction",
            got="the same actions",
            evidence=evidence,
            fix=Fix("advice", "condition each environment on the instruction of its own observation"),
        )
