"""XPL251: A checkpoint or a training step that does not exist is replaced by another one."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.configurations import Configurations
from xpl_cli.audit.served.probe import blame


@rule(code="XPL251", requirement="XPL-CKP-1", profile="full", tries="other checkpoints")
def absent_checkpoint(configurations: Configurations) -> Iterator[Finding]:
    """A checkpoint or a training step that does not exist is replaced by another one.

    ## What it does
    Requests checkpoints with names similar to the real one, and training steps that do not exist: 0, the first digit of
    an existing step (5 for 50000), and ten times that step. Each has to end in an error. If step 0 exists, its actions
    have to differ from those of the newest step.

    ## Why it matters
    The run reports the score of another checkpoint than the requested one, under the requested name.

    ## Example
    `glob(f"step_{step}*")`, which finds step 50000 for 5; `if step:`, which treats 0 as "the newest".

    ## Use instead
    `xpl.checkpoint.resolve` and `xpl.checkpoint.resolve_step`, which never choose another one.

    ## Fix safety
    No automatic fix.
    """
    checkpoint = configurations.probe.checkpoint
    if checkpoint is None:
        raise NotApplicable("deploy.yml names no checkpoint that exists")
    if not checkpoint.absent_names() and not list(checkpoint.step_keys()):
        raise NotApplicable("every name like that of the checkpoint exists, and no key selects a training step")
    for name in checkpoint.absent_names():
        if configurations.changed(**{checkpoint.key: name}).refusal is None:
            yield _finding(f"{checkpoint.key}: {name} does not exist, and the adapter acts with {checkpoint.name}")
    for key, step in checkpoint.step_keys():
        for other in checkpoint.absent_steps(step):
            if configurations.changed(**{key: other}).refusal is None:
                yield _finding(
                    f"{key}: step {other} does not exist, and the adapter acts with another one; {step} exists"
                )
        if step and 0 in checkpoint.steps() and configurations.repeats and configurations.probe.depends_on_observations:
            first = configurations.changed(**{key: 0})
            if first.refusal is None and first.difference(configurations.changed(**{key: step})) is None:
                yield _finding(f"{key}: step 0 acts exactly as step {step}")


def _finding(fault: str) -> Finding:
    return blame(
        f"{fault}: a run reports the score of another checkpoint than the requested one",
        expected="an error that names the missing checkpoint or step",
        got="a server that is ready",
        fix=Fix("advice", "find it with xpl.checkpoint.resolve and resolve_step"),
    )
