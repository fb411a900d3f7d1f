"""XPL224: A failed reset is reported as successful."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl.worker.watch import SWALLOWED
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.in_process_run import InProcessRun
from xpl_cli.audit.served.probe import blame


@rule(code="XPL224", requirement="XPL-EPI-4", tries="resets", handler=spec.Method.RESET)
def reset_fails_loudly(in_process_run: InProcessRun) -> Iterator[Finding]:
    """A failed reset is reported as successful.

    ## What it does
    In a separate process, makes each part that reset calls (methods `reset*` and `clear*` of the model and of its
    attributes) fail, one at a time, and resets. The reset must fail, too.

    ## Why it matters
    The next episode would start with the state of the previous one, unnoticed: the client got no error.

    ## Example
    `try: self.model.reset()` with `except Exception: pass`

    ## Use instead
    Let the exception pass. The server reports it to the client, and the client stops.

    ## Fix safety
    No automatic fix.
    """
    if not in_process_run.broken:
        raise NotApplicable("reset calls nothing that could be made to fail")
    for note in in_process_run.notes_of(SWALLOWED):
        yield blame(
            f"reset continues although {note.key} failed: the next episode starts with the state of the "
            "previous one, unnoticed",
            expected="an error from reset",
            got="no error",
            evidence={"failed": note.key, "tried": list(in_process_run.broken)},
            fix=Fix("advice", "let errors during reset pass"),
        )
