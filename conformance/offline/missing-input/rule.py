"""XPL213: A missing required input is silently replaced."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.faulty_inputs import judge, missing
from xpl_cli.audit.offline.semantics import Semantics
from xpl_cli.audit.served.changed_inputs import present
from xpl_cli.audit.served.probe import Probe

_MADE_UP = "{faults}, the policy continues with a made-up value of {name} instead of stopping"
_UNREAD = "{faults}, the policy continues instead of stopping: {name}, which the manifest requires, is never used"
_UNCLEAR = "{faults}, the policy stops, but its error does not say that {name} is missing"
_FIX = Fix("advice", "read required fields with xpl.observation, which raises, and never default to zeros")
_TEXT = Fix("advice", "read it with xpl.observation.get_instruction(obs, required=True), which raises")


@rule(code="XPL213", requirement="XPL-OBS-3", tries="missing and damaged inputs")
def missing_input(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """A missing required input is silently replaced.

    ## What it does
    Leaves out each input that the manifest requires, one at a time: the whole of it, the values of one arm, the image
    of a declared camera, everything of its group. The result must be an error that names what is missing. Without a
    manifest, the cameras and states on which the action depends count as required; since they are not declared, going
    on is a warning, and any error will do.

    ## Why it matters
    A black image in place of a camera that is unplugged or has another name gives plausible motion and a low score; the
    cause is hard to find.

    ## Example
    `image = vision.get("cam_left_wrist", np.zeros((480, 640, 3)))`

    ## Use instead
    `xpl.observation.get_image(obs, "cam_left_wrist")`, whose error lists the cameras of the observation.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    names = probe.required or _used(semantics)
    obs = probe.observation()
    there = present(obs)
    if not set(names) & set(there):
        raise NotApplicable("the scripted observation holds none of the required inputs, so that none can be left out")
    unseen = semantics.known_ignored_inputs()
    with probe.session() as policy:
        for name in names:
            for finding in judge(
                policy,
                missing(obs, name) if name in there else (),
                goes_on=_UNREAD if name in unseen else _MADE_UP,
                unclear=_UNCLEAR if probe.required else None,
                fix=_TEXT if name == spec.Obs.INSTRUCTION else _FIX,
            ):
                yield finding if probe.required else replace(finding, must=False)


def _used(semantics: Semantics) -> list[str]:
    """Return the inputs that an adapter without a manifest evidently uses; many have a prompt of their own as well."""
    used = [
        change.input
        for change, effect in semantics.effects
        if change.kind == "input" and change.input != spec.Obs.INSTRUCTION and effect is not None
    ]
    if not used:
        raise NotApplicable(f"no {spec.File.POLICY_YML} declares a required input, and none changes the action")
    return used
