"""XPL246: The server reports that it is ready before the model is."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.service import ServiceRun

_TIMES, _LONGER_S = 10.0, 2.0


@rule(code="XPL246", requirement="XPL-SRV-10", profile="full", tries="speed")
def ready_before_loaded(probe: Probe, service: ServiceRun) -> Iterator[Finding]:
    """The server reports that it is ready before the model is.

    ## What it does
    Compares the time of the first action after the server was ready with the later ones: it must not be both ten times
    as long and two seconds longer.

    ## Why it matters
    It delays the first episode of every run: the robot stands still in the middle of a control loop, and a client with
    a short deadline gives up.

    ## Example
    The weights are loaded, or the model is compiled, at the first `get_action`.

    ## Use instead
    Do it in `load`: build the model, and run one inference on a made-up observation if the model compiles itself.

    ## Fix safety
    No automatic fix.
    """
    first, usual = service.first, service.usual
    if first > _TIMES * usual and first - usual > _LONGER_S:
        yield blame(
            (
                f"the first action takes {first:.1f} s, later ones {usual:.3f} s: the server was not ready when it "
                "reported so"
            ),
            expected="a first action that takes about as long as the others",
            got=f"{first:.1f} s",
            fix=Fix("advice", "load and warm up the model in load()"),
        )
    else:
        probe.require_real_time()
