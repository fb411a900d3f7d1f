"""XPL271: The policy is no nearer to demonstrations than holding the pose."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotRun, rule
from xpl_cli.audit.offline.demonstrations.fact import Demonstrated
from xpl_cli.audit.served.probe import blame


@rule(code="XPL271", requirement="XPL-OBS-7", after=("serves",))
def demonstrations_followed(demonstrations: Demonstrated) -> Iterator[Finding]:
    """The policy is no nearer to demonstrations than holding the pose.

    ## What it does
    Compares, over the same questions as XPL270, the error of the policy with that of a witness that needs no model: the
    observed pose, held over the whole horizon. It warns where the witness is nearer, and the episodes leave no doubt of
    that (99 %, paired bootstrap).

    ## Why it matters
    A policy that is farther from its own demonstrations than standing still was not trained on them, or gets or answers
    something else than in training. Of its conventions such demonstrations tell nothing.

    ## Example
    Actions that are denormalised with the statistics of another robot.

    ## Use instead
    If XPL270 names a convention, that one first. Otherwise look whether the demonstrations are of the data that the
    weights were trained on, and whether statistics and checkpoint belong together.

    ## Fix safety
    No automatic fix.
    """
    if demonstrations.refused:
        raise NotRun(f"the adapter refuses {len(demonstrations.refused)} observations of the demonstrations")
    name, still = next(iter(demonstrations.witnesses.items()))
    beside = demonstrations.beside(still)
    if beside is None or beside.least <= 1.0:
        return
    table = demonstrations.table()
    yield blame(
        f"the policy is farther from the demonstrations than {name}: {beside.share:.2g} times its error over "
        f"{demonstrations.episodes} episodes, at least {beside.least:.2g} times",
        expected=f"less than {name}: {_listed(table[name])}",
        got=_listed(table["declared"]),
        evidence={"episodes": demonstrations.episodes, "errors": table},
        fix=Fix("advice", "if XPL270 names no convention: are these the data that the weights were trained on?"),
    )


def _listed(units: dict[str, float]) -> str:
    return ", ".join(f"{value:g} {name}" for name, value in units.items())
