"""XPL245: Processes of the adapter outlive the policy server, or delay its end."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.served.probe import blame
from xpl_cli.audit.served.service import ServiceRun


@rule(code="XPL245", requirement="XPL-SRV-5", loads=True, tries="crashes and leftovers")
def leftover_processes(service: ServiceRun) -> Iterator[Finding]:
    """Processes of the adapter outlive the policy server, or delay its end.

    ## What it does
    Serves the adapter, requests a few actions, stops the server, and looks for processes that the adapter started
    outside its process group or that are still running.

    ## Why it matters
    These processes hold GPU memory, and the next server runs out of it. Launchers end a process group; no launcher ends
    processes outside of it.

    ## Example
    `subprocess.Popen([...], start_new_session=True)` in `load`.

    ## Use instead
    Start children in the adapter's own group, which is the default.

    ## Fix safety
    No automatic fix.
    """
    for member, command in service.left_group:
        yield blame(
            f"process {command!r} left the adapter's process group: it outlives the server, and "
            "keeps memory and devices",
            expected="children in the process group of the adapter",
            got=f"process group {member.group}",
            fix=Fix("advice", "start it without start_new_session and setsid"),
        )
    group_pids = {member.pid for member, _ in service.left_group}
    for member in service.survivors:
        if member.pid not in group_pids:
            yield blame(
                f"process {member.name} is still running after the server has ended: it keeps memory and devices",
                expected="no process of the adapter",
                got=f"process {member.pid}",
                fix=Fix("advice", "start children in the process group of the adapter"),
            )
    if service.code != 0 and service.failure is None:
        yield blame(
            f"the server did not end in order after the signal to stop (exit code {service.code}, after "
            f"{service.stop_seconds:.1f} s): launchers treat that as a failed run",
            expected="exit code 0",
            got=f"exit code {service.code}",
            evidence={"log": service.log[-12:]},
            fix=Fix("advice", "leave signals and the process's end to the server"),
        )
