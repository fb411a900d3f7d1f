"""XPL202: Actions lack keys, dimensions or finite values that the embodiment asks for."""

from __future__ import annotations

from collections.abc import Iterator

from xpl.embodiment import get_embodiment
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.compare import shapes, structure_problem
from xpl_cli.audit.probe import Probe, blame


@rule(code="XPL202", slug="action-structure", gate="offline", requirement="XPL-ACT-1")
def action_structure(probe: Probe) -> Iterator[Finding]:
    """Actions lack keys, dimensions or finite values that the embodiment asks for.

    ## What it does
    Serves the adapter for every embodiment and action type that its manifest declares, shows it a scripted
    observation and checks each action step: exact keys, dimensions, finite values, unit quaternions, grippers between
    0 and 1.

    ## Why it matters
    A robot of another width gets truncated or shifted commands; a controller that meets a NaN stops, or worse, does
    not.

    ## Example
    `actions[:, :6]` on an arm with 7 joints, or `left_arm_joint_state` for a robot with one arm.

    ## Use instead
    `self.embodiment.dims(self.action_type)` for the keys and their dimensions, `xpl.action.unpack` for the split.

    ## Fix safety
    No automatic fix.
    """
    for name, action_type in probe.combinations():
        embodiment = get_embodiment(name)
        with probe.served_as(name, action_type) as policy:
            chunk = policy.act(probe.observation(embodiment=embodiment))
        problem = structure_problem(chunk, embodiment, action_type)
        if problem is not None:
            yield blame(
                f"{action_type} actions for {name} cannot be executed: {problem}",
                expected=", ".join(f"{key} ({dim},)" for key, dim in embodiment.dims(action_type).items()),
                got=shapes(chunk),
                fix=Fix(
                    "advice",
                    "return flat rows of the embodiment's dimension from predict and let the base class unpack them",
                ),
            )
