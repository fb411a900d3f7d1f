"""XPL232: The policy does not distinguish the arms of a robot."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.semantics import Semantics
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL232", requirement="XPL-OBS-7", profile="full", tries="swapped arms")
def distinguishes_arms(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """The policy does not distinguish the arms of a robot.

    ## What it does
    For each state that the manifest requires: swaps left and right, then changes the left arm alone and the right arm
    alone, and checks that the action changes. `inputs-matter` reports states that have no effect at all.

    ## Why it matters
    An arm whose state never reaches the model moves as if it were in the pose of the other one.

    ## Example
    `obs["state"]["left_arm_joint_state"]` twice, after a copy that was not edited.

    ## Use instead
    `xpl.observation.pack_state(obs, self.embodiment, self.action_type)`

    ## Fix safety
    No automatic fix.
    """
    if not any(name.startswith(spec.Obs.STATE) for name in probe.named_inputs()):
        raise NotApplicable("the manifest requires no state")
    if len(probe.embodiment.arms) == 1:
        raise NotApplicable("the robot has one arm")
    unseen = semantics.ignored_inputs()
    semantics.require_change_of_used("sides", "the actions depend on none of the required states")
    for change in semantics.ignored("sides"):
        if change.input not in unseen:
            yield blame(
                f"with {change.what} the action is the same: the policy does not distinguish the arms",
                expected="another action",
                got="the same action",
                fix=Fix("advice", "read both arms, each under its own key, with xpl.observation.pack_state"),
            )
