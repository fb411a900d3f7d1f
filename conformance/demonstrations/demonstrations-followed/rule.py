"""XPL271: The policy predicts demonstrations no better than holding the pose."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotRun, rule
from xpl_cli.audit.offline.demonstrations.fact import DemonstrationComparison
from xpl_cli.audit.served.probe import blame


@rule(code="XPL271", requirement="XPL-OBS-7", after=("serves",), tries="demonstrations")
def demonstrations_followed(demonstrations: DemonstrationComparison) -> Iterator[Finding]:
    """The policy predicts demonstrations no better than holding the pose.

    ## What it does
    Compares, for the same inferences as XPL270, the error of the policy with that of a baseline without a model: the
    observed pose, held over the whole action horizon. It warns if the baseline's error is smaller with 99 % certainty
    (paired bootstrap over episodes).

    ## Why it matters
    A policy whose error is larger than that of holding the pose was not trained on these demonstrations, or its inputs
    or outputs differ from those of training. Such demonstrations cannot verify its conventions.

    ## Example
    Actions that are denormalised with the statistics of another robot.

    ## Use instead
    If XPL270 names a convention, fix that one first. Otherwise check that the weights were trained on data like these
    demonstrations, and that statistics and checkpoint belong together.

    ## Fix safety
    No automatic fix.
    """
    if demonstrations.refusals:
        raise NotRun(f"the adapter refuses {len(demonstrations.refusals)} observations of the demonstrations")
    name, still = next(iter(demonstrations.baselines.items()))
    beside = demonstrations.margin_to(still)
    if beside is None or beside.least <= 1.0:
        return
    table = demonstrations.table()
    yield blame(
        f"the policy's error on the demonstrations is larger than that of {name}: {beside.share:.2g} times as "
        f"large over {demonstrations.episodes} episodes, at least {beside.least:.2g} times",
        expected=f"less than {name}: {_listed(table[name])}",
        got=_listed(table["declared"]),
        evidence={"episodes": demonstrations.episodes, "errors": table},
        fix=Fix("advice", "if XPL270 names no convention: were the weights trained on these data?"),
    )


def _listed(units: dict[str, float]) -> str:
    return ", ".join(f"{value:g} {name}" for name, value in units.items())
