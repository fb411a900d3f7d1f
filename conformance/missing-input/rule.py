"""XPL213: A required input that is missing is silently replaced."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.compare import brief, error_code
from xpl_cli.audit.inputs import without
from xpl_cli.audit.probe import Probe, blame


@rule(code="XPL213", slug="missing-input", gate="offline", requirement="XPL-OBS-3")
def missing_input(probe: Probe) -> Iterator[Finding]:
    """A required input that is missing is silently replaced.

    ## What it does
    Leaves out each input that the manifest requires, one at a time. The answer must be an error.

    ## Why it matters
    A black image in place of a camera that is unplugged or named otherwise gives plausible motion and a low score;
    nobody looks for the cause in the wiring.

    ## Example
    `image = vision.get("cam_left_wrist", np.zeros((480, 640, 3)))`

    ## Use instead
    `xpl.observation.get_image(obs, "cam_left_wrist")`, which says what is there.

    ## Fix safety
    No automatic fix.
    """
    probe.ready()
    obs = probe.observation()
    with probe.session() as policy:
        for name in probe.named_inputs():
            answer = policy.act(without(obs, name))
            if error_code(answer) is None:
                yield blame(
                    f"without {name} the policy goes on with a made-up value instead of stopping",
                    expected=f"an error that names {name}",
                    got=brief(answer),
                    fix=Fix(
                        "advice", "read required fields with xpl.observation, which raises, and never default to zeros"
                    ),
                )
