"""XPL244: The adapter opens a network port of its own."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.served.probe import blame
from xpl_cli.audit.served.service import ServiceRun


@rule(code="XPL244", requirement="XPL-SRV-9", loads=True, tries="crashes and leftovers")
def opens_port(service: ServiceRun) -> Iterator[Finding]:
    """The adapter opens a network port of its own.

    ## What it does
    Looks, while the adapter is served, for TCP ports on which its processes listen.

    ## Why it matters
    A second server on this machine finds the port in use, and fails or connects to the first one's model. The port
    needs no token, so every program that reaches the machine can use it.

    ## Example
    A second policy server that `load` starts on port 8000, and that the adapter calls over HTTP.

    ## Use instead
    Load the model in the adapter's process, or communicate with a child process over a pipe (`multiprocessing.Pipe`).

    ## Fix safety
    No automatic fix.
    """
    for address, member in service.listening:
        yield blame(
            f"the adapter listens on {address} (process {member.name}): a second server on this machine cannot, "
            "or connects to the first one's model",
            expected="no listening socket besides the server's",
            got=address,
            fix=Fix("advice", "load the model in the adapter's own process, or connect a child process by a pipe"),
        )
