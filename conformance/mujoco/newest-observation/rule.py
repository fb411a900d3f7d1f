"""XPL309: The policy answers an observation before the newest."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.physics.lag import reactions
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.served.probe import blame


@rule(code="XPL309", requirement="XPL-SIM-9")
def newest_observation(simulation: Simulation) -> Iterator[Finding]:
    """The policy answers an observation before the newest.

    ## What it does
    Plays a closed loop, then shows its observations again with a single one changed: the newest at a question, or the
    one a step before. The answer to that question has to follow the newest. It lags if it does not, and the change of
    the older one shows, or that of the newest one question later, at several questions.

    ## Why it matters
    A delay of one step hides well: slow tasks still succeed. Where contact counts the arm overshoots, and feedback
    begins to swing.

    ## Example
    `self.window[-2]`, or a thread that encodes the observation for the next call.

    ## Use instead
    Answer from what `update_obs` brought last. What is computed ahead on purpose belongs into a waiver.

    ## Fix safety
    No automatic fix.
    """
    found = reactions(simulation)
    if all(reaction.lags for reaction in found):
        late = all(reaction.late for reaction in found)
        yield blame(
            f"in {simulation.first} answers lag behind: "
            + (
                "what is newest at a question shows in the answer to the next one"
                if late
                else "they follow the observation of the step before"
            ),
            expected="an answer that changes with the newest observation",
            got="the same answer",
            evidence={
                "questions": [
                    {
                        "question": reaction.question,
                        "follows_newest": reaction.newest,
                        "follows_step_before": reaction.older,
                        "next_follows": reaction.late,
                    }
                    for reaction in found
                ]
            },
            fix=Fix("advice", "answer from what update_obs brought last"),
        )
