"""XPL215: Only one spelling of the instruction is understood."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.compare import difference
from xpl_cli.audit.probe import Probe, blame


@rule(code="XPL215", slug="instruction-forms", gate="offline", requirement="XPL-OBS-4")
def instruction_forms(probe: Probe) -> Iterator[Finding]:
    """Only one spelling of the instruction is understood.

    ## What it does
    Shows the same observation once with `instruction` and once with `instructions`, a list whose first entry is the
    same text.

    ## Why it matters
    Both occur in the field. A policy that ignores one of them follows no instruction there, or stops.

    ## Example
    `prompt = obs["instruction"]`

    ## Use instead
    `xpl.observation.get_instruction(obs)`

    ## Fix safety
    No automatic fix.
    """
    probe.ready()
    obs = probe.observation()
    text = obs[spec.Obs.INSTRUCTION]
    listed = {key: value for key, value in obs.items() if key != spec.Obs.INSTRUCTION}
    listed[spec.Obs.INSTRUCTIONS] = [text, "an alternative wording"]
    found = difference(probe.answer(obs), probe.answer(listed))
    if found is not None:
        yield blame(
            "an observation with `instructions` is not understood as one with `instruction`",
            expected="the action for the first of the list",
            got=found,
            fix=Fix("advice", "read it with xpl.observation.get_instruction"),
        )
