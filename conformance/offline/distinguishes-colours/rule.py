"""XPL230: A policy with cameras does not distinguish red from blue."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.semantics import Semantics
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL230", requirement="XPL-OBS-7", profile="full", tries="swapped colours")
def distinguishes_colours(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """A policy with cameras does not distinguish red from blue.

    ## What it does
    Swaps the red and blue channels of each camera that the manifest requires, one at a time, and checks that the action
    changes. `inputs-matter` reports cameras that have no effect at all.

    ## Why it matters
    A policy for which both look the same cannot follow "put the red block on the blue one".

    ## Example
    `image[..., :1]`, meant to drop an alpha channel, or a conversion to grey for a network that was trained on colour.

    ## Use instead
    `xpl.observation.get_image(obs, camera)`, which is (H, W, 3) RGB, passed on with all three channels in this order.

    ## Fix safety
    No automatic fix.
    """
    if not any(name.startswith(spec.Obs.VISION) for name in probe.named_inputs()):
        raise NotApplicable("the manifest requires no camera")
    unseen = semantics.ignored_inputs()
    semantics.require_change_of_used("colours", "the actions depend on none of the required images")
    for change in semantics.ignored("colours"):
        if change.input not in unseen:
            yield blame(
                (
                    f"with {change.what} the action is the same: the policy cannot distinguish a red object from a "
                    "blue one"
                ),
                expected="another action",
                got="the same action",
                fix=Fix("advice", f"pass all three channels of {change.input} to the model, in the order RGB"),
            )
