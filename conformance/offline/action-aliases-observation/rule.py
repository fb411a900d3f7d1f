"""XPL227: An action shares memory with an observation."""

from __future__ import annotations

from collections.abc import Iterator

from xpl.worker.watch import SHARED
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.offline.in_process_run import InProcessRun
from xpl_cli.audit.served.probe import blame

_SHOWN = 4
"""Findings that are made at most; one cause changes many keys."""


@rule(code="XPL227", requirement="XPL-OBS-5", tries="forms of observations")
def action_aliases_observation(in_process_run: InProcessRun) -> Iterator[Finding]:
    """An action shares memory with an observation.

    ## What it does
    Runs episodes in a process without a server and checks whether any array of an action shares memory with an
    observation.

    ## Why it matters
    In one process an action that is clipped or scaled in place changes the observation that it came from, and the next
    observation, written into the same buffer, changes an action that is still being executed.

    ## Example
    `return [{"left_arm_joint_state": obs["state"]["left_arm_joint_state"]}]` to hold the pose.

    ## Use instead
    `np.array(value)`, or the decoding of `xpl.Policy`, which copies.

    ## Fix safety
    No automatic fix.
    """
    # One action step of each chunk and value will do.
    distinct = {(note.method, note.shared_with): note for note in reversed(in_process_run.notes_of(SHARED))}
    for note in list(distinct.values())[:_SHOWN]:
        yield blame(
            f"{note.key} of the result of {note.method} shares memory with {note.shared_with} of the observation: "
            "changing one of them changes the other",
            expected="an array of its own",
            got=f"a view of {note.shared_with}",
            evidence={"operation": note.method, "key": note.key},
            fix=Fix("advice", "return copies of what is taken from an observation"),
        )
