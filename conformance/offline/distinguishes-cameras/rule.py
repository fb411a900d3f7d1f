"""XPL231: A policy with several cameras does not distinguish them."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.semantics import Semantics
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL231", requirement="XPL-OBS-7", profile="full", tries="swapped cameras")
def distinguishes_cameras(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """A policy with several cameras does not distinguish them.

    ## What it does
    Swaps the images of two cameras that the manifest requires, for every pair of them, and checks that the action
    changes. `inputs-matter` reports cameras that have no effect at all.

    ## Why it matters
    What is left in the image of one wrist camera is right in that of the other. A policy that cannot distinguish them
    moves either arm by what the other arm's camera sees.

    ## Example
    `np.mean([vision[name]["color"] for name in names], axis=0)`, or the cameras sorted by their content.

    ## Use instead
    One input of the model for each camera, selected by its name.

    ## Fix safety
    No automatic fix.
    """
    cameras = [name for name in probe.named_inputs() if name.startswith(spec.Obs.VISION)]
    if len(cameras) < 2:
        raise NotApplicable("the manifest requires fewer than two cameras")
    unseen = semantics.ignored_inputs()
    semantics.require_change_of_used("cameras", "the actions depend on none of the required cameras")
    for change in semantics.ignored("cameras"):
        if change.input not in unseen:
            yield blame(
                f"with {change.what} the action is the same: the policy does not distinguish the cameras",
                expected="another action",
                got="the same action",
                fix=Fix("advice", "pass each camera, by its name, to its own input of the model"),
            )
