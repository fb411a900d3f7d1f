"""XPL212: A required input has no effect on the actions."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.semantics import Semantics
from xpl_cli.audit.served.probe import Probe


@rule(code="XPL212", requirement="XPL-OBS-6", tries="effects of inputs")
def inputs_matter(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """A required input has no effect on the actions.

    ## What it does
    Changes each input that the manifest requires, one at a time, and checks that the action changes. Without a manifest
    it looks for cameras of one side that change the action while those of the other side do not.

    ## Why it matters
    A camera, state or instruction that never reaches the model costs bandwidth and hides a bug: the key is read under a
    wrong name, or a value is read and then ignored.

    ## Example
    The prompt is set once from the task name, and the instruction of the observation is ignored.

    ## Use instead
    Use the input, or declare it under `inputs.unused`, so that comparisons between policies list the inputs of each
    one.

    ## Fix safety
    No automatic fix.
    """
    if not probe.package.manifest:
        yield from _one_sided(semantics)
        return
    required = probe.named_inputs()
    unseen = semantics.ignored_inputs()
    for name in required:
        if name in unseen:
            yield Finding(
                message=(
                    f"{name} is declared as required, but changing it does not change the actions: the policy does "
                    "not use it"
                ),
                path=spec.File.POLICY_YML,
                expected=f"another action for another {name}, or {name} under inputs.unused",
                got="the same action",
                fix=Fix("advice", f"use {name} in encode, or move it to inputs.unused in policy.yml"),
            )


def _one_sided(semantics: Semantics) -> Iterator[Finding]:
    """Yield the inputs of one side that change no action, while those of the other side do.

    Raises:
        NotApplicable: no input has a counterpart on the other side.
    """
    unseen = semantics.ignored_inputs()
    names = {change.input for change, _ in semantics.effects if change.kind == "input"}
    pairs = [(name, name.replace("left", "right")) for name in sorted(names) if "left" in name]
    pairs = [(left, right) for left, right in pairs if right in names and {left, right} - unseen]
    if not pairs:
        raise NotApplicable("no policy.yml declares a required input, and no input is one of a left and a right one")
    for pair in pairs:
        for name, other in (pair, pair[::-1]):
            if name in unseen:
                yield Finding(
                    message=f"{name} changes no action, while {other} does: it never reaches the model",
                    path=spec.File.MODEL_PY,
                    expected=f"another action for another {name}",
                    got="the same action",
                    fix=Fix("advice", f"look for {name} in the code that encodes observations"),
                )
