"""XPL236: The length of an action chunk is not the declared one."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.motion import MotionEpisodes
from xpl_cli.audit.served.compare import is_answer_list
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL236", requirement="XPL-ACT-7", tries="shapes of actions")
def chunk_length(probe: Probe, motions: MotionEpisodes) -> Iterator[Finding]:
    """The length of an action chunk is not the declared one.

    ## What it does
    Counts the action steps of every chunk: with each embodiment and action type that the manifest declares, at the
    first observation and at later ones, alone and in a batch.

    ## Why it matters
    An environment plans with the declared length: how many steps it executes, when the next inference runs, and how it
    fills the batch. Chunks of unequal length leave some environments of a batch without an action.

    ## Example
    `actions[: self.execute_steps]`, while policy.yml still declares the model's whole action horizon.

    ## Use instead
    `temporal.chunk` in policy.yml, the number of action steps that one call returns.

    ## Fix safety
    No automatic fix.
    """
    declared = probe.package.manifest.temporal.chunk
    if declared is None:
        raise NotApplicable("no manifest declares the length of a chunk")
    if not any(is_answer_list(answer.chunk) for motion in motions.all for answer in motion.answers):
        raise NotApplicable("no answer is a chunk, which XPL202 reports")
    for motion in motions.all:
        wrong = [answer for answer in motion.answers if is_answer_list(answer.chunk) and len(answer.chunk) != declared]
        if wrong:
            yield blame(
                f"{motion.action_type} chunks for {motion.embodiment.name} do not have the declared length: an "
                f"environment that plans by it executes too few or too many steps",
                expected=f"temporal.chunk, {declared} action steps",
                got=", ".join(f"{len(answer.chunk)} ({answer.where})" for answer in wrong),
                fix=Fix("advice", "return the whole chunk, or declare its length in policy.yml"),
            )
