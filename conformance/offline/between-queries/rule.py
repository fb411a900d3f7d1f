"""XPL229: What is shown between two questions does not reach the model."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.served.compare import answers, first_step, same
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL229", requirement="XPL-EPI-8")
def between_queries(probe: Probe) -> Iterator[Finding]:
    """What is shown between two questions does not reach the model.

    ## What it does
    Shows an observation, asks, shows two more, as a benchmark does while it executes a chunk, and asks again. The
    second answer must follow the newest observation: it must not be what an adapter answers that saw none of the
    two, or only the first of them. With a declared history the observation in between must count, too.

    ## Why it matters
    A policy that looks at the world once per chunk of its own runs open loop while the benchmark believes in
    feedback. With a history, frames at the wrong distance are something that the model never saw in training.

    ## Example
    `if self.queue: return self.queue.pop(0)` in `get_action`, whatever was shown since.

    ## Use instead
    Answer from the newest observation whenever an action is asked for; the client decides how much of a chunk it
    executes.

    ## Fix safety
    No automatic fix.
    """
    probe.ready()
    first, between, newest = ({**probe.observation(scene, scene), spec.Obs.ENV_IDX: 0} for scene in range(3))

    def second(*shown: dict[str, Any]) -> Any:
        with probe.run() as policy:
            policy.act(first)
            for obs in shown:
                policy.update_obs(obs)
            return policy.get_action()

    history = (probe.package.manifest.get("temporal") or {}).get("history") or 1
    both = second(between, newest)
    if same(both, second()):
        problem = "is that of an adapter that saw none of them: the chunk is executed open loop"
        if same(probe.answer(first), probe.answer(newest)):
            raise NotApplicable("the actions do not depend on what is observed")
    elif same(both, second(between)):
        problem = "follows the first of them, not the newest: the policy lags behind"
        if same(probe.answer(between), probe.answer(newest)):
            return
    elif history > 1 and same(both, second(newest)):
        problem = f"leaves out the one in between, although a history of {history} is declared: frames are missing"
    else:
        return
    yield blame(
        f"the answer after two observations in the middle of a chunk {problem}",
        expected="an answer that follows what was shown last, and the declared history",
        got="the same actions as without it",
        evidence={
            "shown": ["scene 0", "asked", "scene 1", "scene 2", "asked"],
            "second_answer": first_step(both) if answers(both) else None,
        },
        fix=Fix("advice", "take in every update_obs, and answer get_action from the newest observation"),
    )
