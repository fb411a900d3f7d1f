"""XPL211: Asking twice on one observation fails, or is answered otherwise."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.served.compare import brief, difference, error_code, first_step, same
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL211", requirement="XPL-EPI-5")
def ask_twice(probe: Probe) -> Iterator[Finding]:
    """Asking twice on one observation fails, or is answered otherwise.

    ## What it does
    Shows one observation and asks for an action twice. Where the policy answers that observation alike whenever it is
    shown again, the second answer must be the first one.

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
        policy.act(probe.observation())
        policy.update_obs(probe.observation())
        shown_again = policy.get_action()
    if error_code(first) is not None:
        return
    if error_code(second) is not None:
        yield blame(
            "a second get_action on the same observation fails: the first one damaged what was stored",
            expected="an action chunk",
            got=brief(second),
            fix=Fix("advice", "never change a stored observation in place; copy before normalising or popping keys"),
        )
    # Random numbers and averaging over time change an answer, too, but then also where the observation is shown again.
    elif same(first, shown_again) and not same(first, second):
        yield blame(
            "a second get_action on the same observation is answered otherwise, although the observation shown again "
            "is answered alike: the first one changed what was stored",
            expected="the same actions",
            got=difference(first, second) or "",
            evidence={"first": first_step(first), "second": first_step(second)},
            fix=Fix("advice", "never change a stored observation in place; copy before normalising or popping keys"),
        )
