"""XPL243: The adapter's process ends, or breaks its connection to the server, during a request."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.service import Service


@rule(code="XPL243", requirement="XPL-SRV-5")
def worker_lives(probe: Probe, service: Service) -> Iterator[Finding]:
    """The adapter's process ends, or breaks its connection to the server, during a request.

    ## What it does
    Checks whether the process is still running after the requests of all other rules. Serves the adapter once more, in
    a new process, and requests eight chunks. Printing is allowed, on every stream: the connection has a file descriptor
    of its own.

    ## Why it matters
    The server has no model left. Every environment that waits for an action loses its episode, and the trial does not
    count.

    ## Example
    `os.closerange(3, 256)`, as in a recipe for background processes; `sys.exit` instead of ending a thread, `os._exit`;
    more memory than the machine has.

    ## Use instead
    Leave file descriptors open that the adapter has not opened. Raise errors: the server reports them to the client,
    and the process continues.

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
