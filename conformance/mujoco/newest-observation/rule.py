"""XPL309: The policy acts on an older observation than the newest one."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.physics.lag import reactions
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.served.probe import blame


@rule(code="XPL309", requirement="XPL-SIM-9", tries="the newest observation")
def newest_observation(simulation: Simulation) -> Iterator[Finding]:
    """The policy acts on an older observation than the newest one.

    ## What it does
    Runs a rollout, then sends its observations again with a single one changed: the newest at an inference, or the one
    a step before, by the same amount. Only the relative change of actions counts: an action lags if changing the older
    observation, or the newest one with the action of the next inference, has more than four times the effect, at
    several inferences.

    ## Why it matters
    A delay of one step is hard to notice: slow tasks still succeed. In contact the arm overshoots, and the control loop
    oscillates.

    ## Example
    `self.window[-2]`, or a thread that encodes the observation for the next call.

    ## Use instead
    Compute actions from the latest `update_obs`. If the delay is intended, waive the rule.

    ## Fix safety
    No automatic fix.
    """
    measured = reactions(simulation)
    if all(reaction.lags for reaction in measured):
        late = all(reaction.late >= (reaction.older or 0.0) for reaction in measured)
        moved = ", ".join(f"{reaction.newest:.2g}" for reaction in measured)
        before = ", ".join(f"{reaction.before:.2g}" for reaction in measured)
        yield blame(
            f"in {simulation.first} actions lag behind: "
            + (
                "the newest observation at an inference affects only the action of the next one"
                if late
                else "they follow the observation of the step before"
            )
            + (", and little that of its own" if any(reaction.newest for reaction in measured) else ""),
            expected="an action that changes with the newest observation",
            got=f"it moves by {moved} of its spread with the newest, by {before} with the one before",
            evidence={
                "questions": [
                    {
                        "question": reaction.inference,
                        "moved_by_newest": round(reaction.newest, 4),
                        "moved_by_step_before": None if reaction.older is None else round(reaction.older, 4),
                        "next_moved": round(reaction.late, 4),
                    }
                    for reaction in measured
                ]
            },
            fix=Fix(
                "advice",
                (
                    "compute the action from the latest update_obs; compare the order of a history with the "
                    "authors' own code"
                ),
            ),
        )
