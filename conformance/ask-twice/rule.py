"""XPL211: Asking twice on one observation fails."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.compare import brief, error_code
from xpl_cli.audit.probe import Probe, blame


@rule(code="XPL211", slug="ask-twice", gate="offline", requirement="XPL-EPI-5")
def ask_twice(probe: Probe) -> Iterator[Finding]:
    """Asking twice on one observation fails.

    ## What it does
    Shows one observation and asks for an action twice.

    ## Why it matters
    Clients retry and debug tools ask again. An adapter whose inference consumes or changes the stored observation
    fails then, or answers from half-normalised data.

    ## Example
    `obs["state"].pop("left_ee_pose")` during inference.

    ## Use instead
    Make `encode` pure: build new arrays and leave the observation alone.

    ## Fix safety
    No automatic fix.
    """
    probe.ready()
    with probe.session() as policy:
        first = policy.act(probe.observation())
        second = policy.get_action()
    if error_code(first) is None and error_code(second) is not None:
        yield blame(
            "a second get_action on the same observation fails: the first one damaged what was stored",
            expected="an action chunk",
            got=brief(second),
            fix=Fix("advice", "never change a stored observation in place; copy before normalising or popping keys"),
        )
