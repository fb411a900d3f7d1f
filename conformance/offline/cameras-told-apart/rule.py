"""XPL231: A policy with several cameras does not tell them apart."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.semantics import Semantics
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL231", requirement="XPL-OBS-7", profile="full")
def cameras_told_apart(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """A policy with several cameras does not tell them apart.

    ## What it does
    Exchanges the pictures of two cameras that the manifest requires, for every two of them, and looks whether the
    action changes. Cameras that have no effect at all are left to `inputs-matter`.

    ## Why it matters
    What is left in the picture of one wrist is right in that of the other. A policy to which both are one picture moves
    either arm for what the other one sees.

    ## Example
    `np.mean([vision[name]["color"] for name in names], axis=0)`, or the cameras sorted by their content.

    ## Use instead
    One place of the model's input for each camera, by its name.

    ## Fix safety
    No automatic fix.
    """
    cameras = [name for name in probe.named_inputs() if name.startswith(spec.Obs.VISION)]
    if len(cameras) < 2:
        raise NotApplicable("the manifest requires fewer than two cameras")
    unseen = semantics.unseen()
    for change in semantics.ignored("cameras"):
        if change.input not in unseen:
            yield blame(
                f"with {change.what} the action is the same: the policy does not know which camera sees what",
                expected="another action",
                got="the same action",
                fix=Fix("advice", "give each camera, by its name, a place of its own in the model's input"),
            )
