"""XPL201: The policy cannot be served."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotRun, rule
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL201", requirement="XPL-CON-1", tries="loading the model")
def serves(probe: Probe) -> Iterator[Finding]:
    """The policy cannot be served.

    ## What it does
    Starts the real policy server on the adapter, in its own interpreter, and waits until the model is loaded. If a
    third-party module or the checkpoint is missing, an adapter of xpl.Policy is served without its model (shadow mode);
    any other is reported as not run, with what is missing: that is no fault of the adapter.

    ## Why it matters
    A benchmark that queues for hours and then cannot load the policy has measured nothing.

    ## Example
    `self.horizon = config["horizon"]`, although deploy.yml has no such key: a KeyError in the server, a timeout in the
    client.

    ## Use instead
    Read settings with `self.setting(name, default)` and build the model in `load`. `xpl serve` shows the whole
    traceback.

    ## Fix safety
    No automatic fix.
    """
    try:
        probe.server()
    except NotRun:
        if probe.presence.loss is not None:
            yield _removed(probe.presence.loss)
            return
        problem = probe.start_problem
        if problem is None:
            return  # it started, and ended later: `worker-crash` says why
        if problem.lacks is not None:
            raise
        yield blame(
            f"the policy cannot be served: {probe.describe_end(problem.reason, problem.log)}",
            expected="Model(config) returns and the server announces that it is ready",
            got=problem.log[-1] if problem.log else "no output",
            evidence={"log": list(problem.log[-12:])},
            fix=Fix("command", f"xpl serve {probe.package.path}"),
        )
        return
    if probe.presence.loss is not None:
        yield _removed(probe.presence.loss)


def _removed(loss: str) -> Finding:
    return blame(
        f"{loss}; it cannot be served again",
        expected="unchanged files",
        got=loss,
        fix=Fix("advice", "write and delete in a temporary folder only"),
    )
