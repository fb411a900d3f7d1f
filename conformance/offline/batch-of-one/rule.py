"""XPL219: A batch of one environment gives other actions than a single call."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.served.compare import difference, first_step, is_answer_list, raised
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL219", requirement="XPL-BAT-7", compares=True, tries="batches in other orders and sizes")
def batch_of_one(probe: Probe) -> Iterator[Finding]:
    """A batch of one environment gives other actions than a single call.

    ## What it does
    Runs one episode of environment 5 with `update_obs` and `get_action`, with `update_obs_batch` and
    `get_action_batch([5])`, and with `get_action_batch(None)`, and compares the chunks of every step. That None raises
    is XPL204's finding, not one of this rule.

    ## Why it matters
    Benchmarks use either form; `eval_batch` in deploy.yml decides. If the two prepare inputs separately, they diverge,
    and the score depends on a flag that should only affect the speed.

    ## Example
    `get_action` scales the state and `get_action_batch` does not.

    ## Use instead
    One code path: let `get_action` return `get_action_batch([env])[0]`, as `xpl.Policy` does.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    env = 5
    batch = probe.batch_episode([env])
    if not any(is_answer_list(chunks, 1) for chunks in batch):
        raise NotApplicable(f"get_action_batch([{env}]) always fails, which XPL203 reports")
    with probe.run() as policy:
        single = [[chunk] for chunk in probe.episode(policy, env)]
    with probe.run() as policy:
        policy.reset()
        implied = [policy.act_batch_at_once(probe.observations([env], step), None) for step in range(len(batch))]
    forms = [("get_action()", single)]
    if all(raised(answer) is None for answer in implied):  # else XPL204 reports it
        forms.append(("get_action_batch(None)", implied))
    for form, episode in forms:
        for step, (expected, answer) in enumerate(zip(batch, episode, strict=True)):
            mismatch = difference(expected, answer)
            if mismatch is not None:
                error = next((raised(entry) for entry in answer if raised(entry)), None) if answer else None
                yield blame(
                    f"{form} raises {error} at step {step}, where get_action_batch([{env}]) answers: the same episode "
                    "ends in an error unless an evaluation is batched"
                    if error
                    else f"{form} gives environment {env} other actions than get_action_batch([{env}]), from step "
                    f"{step} on: the score depends on whether an evaluation is batched",
                    expected=f"the actions of get_action_batch([{env}])",
                    got=mismatch,
                    evidence={
                        "environment": env,
                        "step": step,
                        "batch": first_step(expected[0]) if is_answer_list(expected) else None,
                        "other": first_step(answer[0]) if is_answer_list(answer) else None,
                    },
                    fix=Fix("advice", "implement the single call with the batched one, with a list of one environment"),
                )
                break
