"""XPL226: The adapter changes an observation that it got."""

from __future__ import annotations

from collections.abc import Iterator

from xpl.worker.watch import CHANGED
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.offline.in_process_run import InProcessRun
from xpl_cli.audit.served.probe import blame

_SHOWN = 4
"""Findings that are made at most; one cause changes many keys."""


@rule(code="XPL226", requirement="XPL-OBS-5", tries="forms of observations")
def observation_intact(in_process_run: InProcessRun) -> Iterator[Finding]:
    """The adapter changes an observation that it got.

    ## What it does
    Runs episodes in a process without a server, passes the adapter writable arrays, and compares every observation
    before and after every operation, also earlier ones.

    ## Why it matters
    Arrays from the wire are read-only, so such an adapter fails, or writes into shared memory behind numpy's back. In
    one process it changes the benchmark's own data: the logged observation is not what the robot observed.

    ## Example
    `obs["state"]["left_arm_joint_state"] /= np.pi`

    ## Use instead
    `state = obs["state"]["left_arm_joint_state"] / np.pi`, which makes a new array.

    ## Fix safety
    No automatic fix.
    """
    for note in in_process_run.notes_of(CHANGED)[:_SHOWN]:
        yield blame(
            f"{note.method} changes {note.key} of an observation that it got: it fails on read-only arrays, and "
            "corrupts data of its caller",
            expected="the observation as it was",
            got=f"another value of {note.key} after {note.method}",
            evidence={"operation": note.method, "key": note.key},
            fix=Fix("advice", "copy before changing: np.array(value), dict(obs)"),
        )
