"""XPL263: A hook raises an error, or affects the next trial."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl.client import ClientError
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.trials import RESULT, trial_case
from xpl_cli.audit.served.compare import brief, difference, error_code, first_step, is_answer_list
from xpl_cli.audit.served.probe import Probe, blame

if TYPE_CHECKING:
    from xpl.contract import Config
    from xpl_cli.audit.served.recorded_client import Answer, RecordedClient

_HOOK: Final = {sdk.Message.PREPARE_CASE: sdk.Method.PREPARE_CASE, sdk.Message.TRIAL_END: sdk.Method.ON_TRIAL_END}


@rule(code="XPL263", requirement="XPL-EPI-1", compares=True, tries="resets")
def trial_hooks(probe: Probe) -> Iterator[Finding]:
    """A hook raises an error, or affects the next trial.

    ## What it does
    In a separate server, runs the same trial twice as benchmarks do: PREPARE_CASE, reset, an episode, TRIAL_END. The
    hooks `prepare_case(case_meta)` and `on_trial_end(result)` get the arguments that `xpl eval` passes. Neither may
    raise, and the second trial must equal the first one. Not applicable if no file of the package has a hook and
    nothing is wrong.

    ## Why it matters
    RoboTwin and `xpl eval` send both for every episode. A hook that raises ends the episode; one that counts, learns
    from results or frees the model makes each episode depend on those before it.

    ## Example
    `def on_trial_end(self, result): del self.net`, or a `prepare_case` that reads a key which only one benchmark sends.

    ## Use instead
    Read what is there with `case_meta.get(...)`, store nothing in a hook that reset does not clear, and change nothing
    that actions are computed from.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    case = trial_case(probe)
    played: list[list[Answer]] = []
    try:
        with probe.fresh_session() as policy:
            for number in range(2):
                failed, chunks = _trial(probe, policy, case)
                if failed is not None:
                    hook, answer = failed
                    again = "" if number == 0 else " the second time"
                    yield blame(
                        f"{_HOOK[hook]} raises{again}: benchmarks that send {hook} lose the episode",
                        expected="an answer, or no hook",
                        got=brief(answer),
                        evidence={"told": case if hook == sdk.Message.PREPARE_CASE else RESULT},
                        fix=Fix("advice", f"use .get(), since benchmarks send different keys in {hook}"),
                    )
                    return
                played.append(chunks)
    except ClientError as error:
        yield blame(
            "a hook ends the adapter: a benchmark that sends PREPARE_CASE and TRIAL_END runs one episode",
            expected="an adapter that continues",
            got=str(error),
            fix=Fix("advice", "free nothing in a hook that the next episode needs"),
        )
        return
    findings = list(_compared(probe, *played))
    if not findings and not _has_hook(probe):
        raise NotApplicable(f"no Python file of the package defines {' or '.join(_HOOK.values())}")
    yield from findings


def _trial(probe: Probe, policy: RecordedClient, case: Config) -> tuple[tuple[str, Answer] | None, list[Answer]]:
    """Play a trial; return the hook that raised with its answer, if one did, and the chunks of the episode."""
    reply = policy.prepare_case(case)
    if error_code(reply) is not None:
        return (sdk.Message.PREPARE_CASE, reply), []
    chunks = probe.episode(policy, env=1)
    reply = policy.trial_end(RESULT)
    if error_code(reply) is not None:
        return (sdk.Message.TRIAL_END, reply), chunks
    return None, chunks


def _has_hook(probe: Probe) -> bool:
    """Tell whether a Python file directly in the package mentions a hook."""
    texts = (file.read_text(encoding="utf-8", errors="replace") for file in probe.package.path.glob("*.py"))
    return any(hook in text for text in texts for hook in _HOOK.values())


def _compared(probe: Probe, first: list[Answer], second: list[Answer]) -> Iterator[Finding]:
    """Yield where the first trial fails, or the second one goes otherwise."""
    refused = next((chunk for chunk in first if error_code(chunk) is not None), None)
    if refused is not None:
        yield blame(
            "after prepare_case the policy returns no actions: benchmarks that send it lose every episode",
            expected="actions, as without prepare_case",
            got=brief(refused),
            fix=Fix("advice", "change nothing in prepare_case that an episode needs"),
        )
        return
    for step, pair in enumerate(zip(first, second, strict=True)):
        mismatch = difference(*pair)
        if mismatch is None:
            continue
        if all(error_code(chunk) is None for chunk in pair):
            probe.require_deterministic()
            if not probe.repeats_in_place:
                raise NotApplicable("each episode has other random numbers, whatever the hooks do")
        yield blame(
            f"the second of two equal trials differs from step {step} on: state that a hook left survives reset",
            expected="the actions of the first trial",
            got=mismatch,
            evidence={
                "step": step,
                "first_and_second": [first_step(chunk) if is_answer_list(chunk) else brief(chunk) for chunk in pair],
            },
            fix=Fix("advice", "change nothing in a hook that actions are computed from, or clear it in reset"),
        )
        return
