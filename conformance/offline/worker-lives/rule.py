"""XPL243: The adapter's process ends, or breaks its link to the server, while it is asked."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.service import Service


@rule(code="XPL243", requirement="XPL-SRV-5")
def worker_lives(probe: Probe, service: Service) -> Iterator[Finding]:
    """The adapter's process ends, or breaks its link to the server, while it is asked.

    ## What it does
    Looks whether the process is still there after all that other rules asked of it. Serves the adapter once more, in a
    new process, and asks it for eight chunks. Printing is fine, on every stream: the link is a
    descriptor of its own.

    ## Why it matters
    The server has nothing left to ask. Every environment that waits for an answer loses its episode, and the trial
    counts for nothing.

    ## Example
    `os.closerange(3, 256)`, which a recipe for background processes calls for; `sys.exit` in a thread's place,
    `os._exit`; more memory than the machine has.

    ## Use instead
    Leave descriptors alone that the adapter has not opened. Raise what went wrong: the client is told, and the process
    lives on.

    ## Fix safety
    No automatic fix.
    """
    if probe.ended is not None:
        yield blame(
            f"the adapter's process ended over a question that it may refuse: {probe.ended}; every environment that it "
            "serves loses its episode",
            expected="an exception, which is sent to whoever asked",
            got=probe.ended,
            fix=Fix("advice", "raise an exception where a request is wrong, and never end the process"),
        )
    if service.trouble is not None:
        yield blame(
            f"the adapter's process cannot go on after {len(service.seconds)} answers: {service.trouble}; "
            "every episode that it serves is lost",
            expected="an answer, or an exception, to every request",
            got=service.trouble,
            evidence={"log": service.log[-12:]},
            fix=Fix("advice", "close and write to no descriptor that the adapter has not opened, and raise errors"),
        )
