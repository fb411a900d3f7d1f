"""XPL222: An error in one episode affects the next one."""

from __future__ import annotations

from collections.abc import Iterator

from xpl.client import ClientError
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.damage import damaged_operations
from xpl_cli.audit.served.compare import brief, difference, error_code, first_step, is_answer_list
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL222", requirement="XPL-EPI-1", compares=True, tries="errors within an episode")
def after_an_error(probe: Probe) -> Iterator[Finding]:
    """An error in one episode affects the next one.

    ## What it does
    In a fresh server, sends invalid observations in the middle of an episode (empty, without state, without images, of
    the wrong type; a batch whose second observation is invalid) and requests unknown environments. Then it resets and
    runs an episode, which must equal the same episode after one without errors.

    ## Why it matters
    One bad observation of a simulator must not affect all later episodes. State that an error leaves inconsistent, and
    that reset does not clear, changes results in a way that is hard to trace to the error.

    ## Example
    `self.busy = True` at the start of an inference and `self.busy = False` at its end.

    ## Use instead
    Change state only after everything that can fail has succeeded, and clear all of it in reset.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    with probe.run() as policy:
        probe.episode(policy, steps=2)
        expected = probe.episode(policy, env=1)
    refused: list[str] = []
    advice = Fix("advice", "change state only after everything that can fail, and clear all of it in reset")
    try:
        with probe.fresh_session() as policy:  # the server that all share may not survive this
            probe.episode(policy, steps=2)
            for what, operate in damaged_operations(probe):
                if error_code(operate(policy)) is not None:
                    refused.append(what)
            reset = policy.reset()
            after = probe.episode(policy, env=1)
    except ClientError as error:
        yield blame(
            (
                "an invalid observation ends the adapter instead of being refused: one bad frame ends the whole "
                "evaluation"
            ),
            expected="an error",
            got=str(error),
            evidence={"refused_before": refused},
            fix=Fix("advice", "raise an error for an invalid observation; never end the process"),
        )
        return
    if error_code(reset) is not None:
        yield blame(
            "reset fails after an error: no further episode can run",
            expected="a new episode",
            got=brief(reset),
            evidence={"refused": refused},
            fix=advice,
        )
        return
    for step, pair in enumerate(zip(expected, after, strict=True)):
        mismatch = difference(*pair)
        if mismatch is not None:
            probe.require_repeatable_afresh()
            yield blame(
                f"the episode after one with errors differs, from step {step} on: state that an error left "
                "survives reset",
                expected="the actions of the same episode after one without errors",
                got=mismatch,
                evidence={
                    "step": step,
                    "refused": refused,
                    "after_no_error_and_after_errors": [
                        first_step(chunk) if is_answer_list(chunk) else brief(chunk) for chunk in pair
                    ],
                },
                fix=advice,
            )
            return
    if not refused:
        raise NotApplicable("the adapter refuses none of the invalid observations: no error came before the episode")
