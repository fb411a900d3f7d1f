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
    one a step before, by as much. How far answers move is compared, not measured in radians: an answer lags if the
    change of the older one, or that of the newest one question later, moves it more than four times as far, at several
    questions.

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
        late = all(reaction.late >= (reaction.older or 0.0) for reaction in found)
        moved = ", ".join(f"{reaction.newest:.2g}" for reaction in found)
        before = ", ".join(f"{reaction.before:.2g}" for reaction in found)
        yield blame(
            f"in {simulation.first} answers lag behind: "
            + (
                "what is newest at a question shows in the answer to the next one"
                if late
                else "they follow the observation of the step before"
            )
            + (", and little in its own" if any(reaction.newest for reaction in found) else ""),
            expected="an answer that changes with the newest observation",
            got=f"it moves by {moved} of its spread with the newest, by {before} with the one before",
            evidence={
                "questions": [
                    {
                        "question": reaction.question,
                        "moved_by_newest": round(reaction.newest, 4),
                        "moved_by_step_before": None if reaction.older is None else round(reaction.older, 4),
                        "next_moved": round(reaction.late, 4),
                    }
                    for reaction in found
                ]
            },
            fix=Fix(
                "advice",
                "answer from what update_obs brought last; of a history, compare the order with the authors' own code",
            ),
        )
