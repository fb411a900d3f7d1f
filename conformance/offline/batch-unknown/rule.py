"""XPL205: An unknown or repeated environment gets an action instead of an error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.served.compare import brief, error_code, is_answer_list, same
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.recorded_client import Answer
from xpl_cli.basics.phrases import count_noun

_OBSERVED: Final = [3, 7]


@rule(code="XPL205", requirement="XPL-BAT-3", tries="empty batches and unknown environments")
def batch_unknown(probe: Probe) -> Iterator[Finding]:
    """An unknown or repeated environment gets an action instead of an error.

    ## What it does
    Observes environments 3 and 7, then requests [3, 8] and [3, 3]. Both must be errors.

    ## Why it matters
    The action can only come from another environment's observation. An off-by-one error of a launcher then goes
    unnoticed.

    ## Example
    `obs = self.obs.get(env, self.last_obs)`

    ## Use instead
    `obs = self.obs[env]`, which raises a KeyError, or `xpl.Policy`, whose error lists the known environments.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    observed = _OBSERVED
    for indices in ([3, 8], [3, 3]):
        with probe.session() as policy:
            policy.reset()
            known = policy.act_batch_at_once(probe.observations(observed), observed)
            policy.reset()
            answer = policy.act_batch_at_once(probe.observations(observed), indices)
        probe.require_chunks(known, observed)  # else every list is refused
        if error_code(answer) is None:
            yield blame(
                f"get_action_batch({indices}) {_describe(indices, answer, known)}",
                expected="an error that names the environment",
                got=brief(answer),
                fix=Fix(
                    "advice", "raise an error for an environment index without an observation, and for a repeated one"
                ),
            )


def _describe(indices: Sequence[int], answer: Answer, known: Answer) -> str:
    """Return what an adapter answers where it has to refuse, and what follows."""
    unseen = "an off-by-one error of a launcher stays unnoticed"
    if not is_answer_list(answer, len(indices)):
        count = count_noun(len(answer), "chunk") if isinstance(answer, (list, tuple)) else brief(answer)
        return f"answers {count} for {len(indices)} indices without an error: chunks no longer match environments"
    if len(set(indices)) < len(indices):
        twice = "answers environment 3 twice" if same(*answer) else "gives environment 3 two different chunks"
        return f"{twice} without an error: a launcher that lists one environment twice stays unnoticed"
    sources = [env for env, chunk in zip(_OBSERVED, known, strict=True) if same(answer[1], chunk)]
    what = f"the action for environment {sources[0]}" if sources else "an action that it makes up"
    return f"gives environment 8, which was never observed, {what}: {unseen}"
