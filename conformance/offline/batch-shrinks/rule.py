"""XPL218: The actions of an environment change after other environments of its batch have ended."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.in_process_run import InProcessRun
from xpl_cli.audit.served.compare import first_step, is_answer_list, same
from xpl_cli.audit.served.probe import Probe, blame

_STEPS: tuple[tuple[list[int], list[int] | None], ...] = (
    ([0, 1, 2, 3], [0, 1, 2, 3]),
    ([0, 1, 2, 3], [0, 2, 3]),  # 1 has ended in the middle of the chunk
    ([3, 0], [3, 0]),
    ([3], None),
)
"""Environments that are observed, and those that are asked for, step by step."""
_COMPARED = (3, 0)


@rule(
    code="XPL218",
    requirement="XPL-BAT-5",
    after=("batch-order", "batch-none-and-empty", "batch-independent"),
    compares=True,
    tries="batches in other orders and sizes",
)
def batch_shrinks(probe: Probe, in_process_run: InProcessRun) -> Iterator[Finding]:
    """The actions of an environment change after other environments of its batch have ended.

    ## What it does
    Runs one episode of four environments that end one after the other: all four, then without environment 1, then 3
    before 0, then 3 alone, requested with `None`. The actions of each running environment must equal those of a run on
    its own, up to batch-size-dependent floating-point error (XPL207).

    ## Why it matters
    Episodes of a batch end at different times. State that is stored by position moves to another robot as soon as an
    earlier one has ended: its history, its queue or its hidden state is then that of a neighbour.

    ## Example
    `self.hidden[:len(obs_list)]` keeps one row per position in the batch.

    ## Use instead
    A dict keyed by environment index, or the state that `xpl.Policy` keeps for each environment.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    instruction = probe.observation()[spec.Obs.INSTRUCTION]
    with probe.run() as policy:
        policy.reset()
        together = []
        for step, (observed, requested) in enumerate(_STEPS):
            policy.update_obs_batch(probe.observations(observed, step, instruction))
            together.append(policy.get_action_batch(requested))
    probe.require_chunks(together[0], _STEPS[0][0])
    if same(*(together[0][env] for env in _COMPARED)):
        raise NotApplicable(
            "the environments of a batch get the same actions: one's state in another's place cannot be seen"
        )
    for env in _COMPARED:
        lasts = sum(env in observed for observed, _ in _STEPS)
        for step, alone in enumerate(probe.batch_episode([env], lasts, instruction)):
            observed, requested = _STEPS[step]
            indices = observed if requested is None else requested
            answered, position = together[step], indices.index(env)
            beside = answered[position : position + 1] if is_answer_list(answered, len(indices)) else answered
            mismatch = probe.batch_difference(alone, beside)
            if mismatch is not None:
                in_process_run.require_no_draws(probe, of_batches=True)
                yield blame(
                    f"environment {env} acts differently in a batch whose other environments end than alone, "
                    f"from step {step} on: its state is stored by position in the batch",
                    expected="the actions of a run alone",
                    got=mismatch,
                    evidence={
                        "environment": env,
                        "step": step,
                        "observed": [list(entry) for entry, _ in _STEPS[: step + 1]],
                        "alone": first_step(alone[0]) if is_answer_list(alone) else None,
                        "beside": first_step(beside[0]) if is_answer_list(beside) else None,
                    },
                    fix=Fix("advice", "store all state between calls in a dict keyed by environment index"),
                )
                return
