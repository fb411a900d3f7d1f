"""XPL247: A chunk takes longer to compute than to execute."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.service import ServiceRun

_RATE = "control_frequency"


@rule(code="XPL247", requirement="XPL-SRV-6", profile="full", tries="speed")
def inference_rate(probe: Probe, service: ServiceRun) -> Iterator[Finding]:
    """A chunk takes longer to compute than to execute.

    ## What it does
    Compares the inference time, the median of seven, with the duration of a chunk at the control frequency that the
    manifest declares.

    ## Why it matters
    The robot waits for the policy between two chunks, or the declared rate is wrong. A policy that was trained at 30 Hz
    then moves at 10 Hz. The machine of the audit counts; another one may be faster.

    ## Example
    `control_frequency: 50` and chunks of one step, with an inference time of 100 ms.

    ## Use instead
    Declare a rate that the policy can keep, return longer chunks, or make the model faster.

    ## Fix safety
    No automatic fix.
    """
    rate = probe.package.manifest.control_frequency
    if rate is None:
        raise NotApplicable("the manifest declares no control frequency")
    usual, lasts = service.usual, service.steps / rate
    if usual > lasts:
        yield blame(
            f"an inference takes {1e3 * usual:.0f} ms, its {service.steps} steps last {1e3 * lasts:.0f} ms at "
            f"{rate:g} Hz: the robot waits, and moves slower than declared",
            expected=f"less than {1e3 * lasts:.0f} ms",
            got=f"{1e3 * usual:.0f} ms",
            fix=Fix("advice", f"declare a {_RATE} that can be kept, or return longer chunks"),
        )
    else:
        probe.require_real_time()
