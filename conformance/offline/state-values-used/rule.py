"""XPL233: One joint or coordinate of a required state has no effect on the actions."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.semantics import Semantics
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL233", requirement="XPL-OBS-7", tries="effects of inputs")
def state_values_used(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """One joint or coordinate of a required state has no effect on the actions.

    ## What it does
    Changes each joint, gripper and coordinate of the states that the manifest requires a little, one at a time, and
    checks that the action changes. `inputs-matter` reports states that have no effect at all.

    ## Why it matters
    A state vector that is truncated to the dimensions of another robot lacks the last joint; the arm moves as if that
    joint stood still.

    ## Example
    `state[:6]` for an arm of seven joints.

    ## Use instead
    `xpl.observation.pack_state`, and `xpl.action.action_dim(self.embodiment, self.action_type)` for its width.

    ## Fix safety
    No automatic fix.
    """
    if not any(name.startswith(spec.Obs.STATE) for name in probe.named_inputs()):
        raise NotApplicable("the manifest requires no state")
    unseen = semantics.ignored_inputs()
    semantics.require_change_of_used("value", "the actions depend on none of the required states")
    ignored = [change for change in semantics.ignored("value") if change.input not in unseen]
    for name, changes in groupby(ignored, key=lambda change: change.input):
        what = ", ".join(change.what.removeprefix("another ") for change in changes)
        yield blame(
            f"the policy does not use {what}: the rest of {name} reaches the model, this does not",
            expected="another action when one of these values changes",
            got="the same action",
            fix=Fix("advice", "take the dimension of the state from the embodiment and pass on all of it"),
        )
