"""XPL243: The adapter's process ends, or breaks its connection to the server, during a request."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.service import ServiceRun


@rule(code="XPL243", requirement="XPL-SRV-5", loads=True, tries="crashes and leftovers")
def worker_crash(probe: Probe, service: ServiceRun) -> Iterator[Finding]:
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
    if probe.end_reason is not None:
        yield blame(
            f"the adapter's process ended at a request that it may refuse: {probe.end_reason}; every environment "
            "that it serves loses its episode",
            expected="an exception, which the server sends to the client",
            got=probe.end_reason,
            fix=Fix("advice", "raise an exception for a wrong request, and never end the process"),
        )
    if service.failure is not None:
        yield blame(
            f"the adapter's process cannot continue after {len(service.seconds)} actions: {service.failure}; "
            "every episode that it serves is lost",
            expected="a result, or an exception, for every request",
            got=service.failure,
            evidence={"log": service.log[-12:]},
            fix=Fix(
                "advice", "close and write to no file descriptor that the adapter has not opened, and raise errors"
            ),
        )
