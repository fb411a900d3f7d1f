"""XPL234: The actions depend on an input that the manifest does not list, or lists as unused."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl.manifest import Inputs
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.semantics import Semantics
from xpl_cli.audit.served.probe import Probe


@rule(code="XPL234", requirement="XPL-CFG-9", profile="full", tries="effects of inputs")
def undeclared_input(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """The actions depend on an input that the manifest does not list, or lists as unused.

    ## What it does
    Changes each input of the scripted observation, one at a time. If the action changes, the manifest has to list the
    input as required or optional.

    ## Why it matters
    A policy that is declared not to read the instruction, but does, has more information than the policies that it is
    compared with. And an environment leaves out undeclared inputs.

    ## Example
    `unused: [vision.cam_head]`, left from the template, above an `encode` that reads that camera.

    ## Use instead
    The input under `inputs.required`, or `inputs.optional` if the policy also works without it.

    ## Fix safety
    No automatic fix.
    """
    required = probe.named_inputs()
    declared = probe.package.manifest.inputs or Inputs()
    listed = {*required, *declared.optional}
    if all(change.input in listed for change, _ in semantics.effects if change.kind == "input"):
        raise NotApplicable("the manifest lists every input of the scripted observation")
    if all(effect is None for change, effect in semantics.effects if change.kind == "input"):
        raise NotApplicable("no input changes the actions")
    for change, effect in semantics.effects:
        name = change.input
        if change.kind != "input" or effect is None or name in listed:
            continue
        declaration = "declares it unused" if name in declared.unused else "does not name it"
        yield Finding(
            message=(
                f"the action depends on {name}, but the manifest {declaration}: comparisons treat it as a policy "
                "without this input"
            ),
            path=spec.File.POLICY_YML,
            expected=f"{name} under inputs.required or inputs.optional, or actions that do not depend on it",
            got=f"with {change.what}: {effect}",
            fix=Fix("advice", f"declare {name} in policy.yml, or stop reading it"),
        )
