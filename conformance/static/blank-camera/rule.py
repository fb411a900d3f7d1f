"""XPL123: A camera that is missing is an error."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.adapter import ACTING, OBSERVING, Adapter
from xpl_cli.audit.static.blanks import blanks
from xpl_cli.audit.static.source import Source


@rule(code="XPL123", requirement="XPL-OBS-3")
def blank_camera(source: Source) -> Iterator[Finding]:
    """A camera that is missing becomes a black image.

    ## What it does
    Looks in what the observing and acting methods reach for images of zeros that stand in where a look-up found
    nothing. Where policy.yml declares a camera optional, a stand-in may be meant, and nothing is reported.

    ## Why it matters
    A misspelt camera name, or an environment without that camera, gives a policy that is blind on one eye. It still
    moves, and its low score looks like a property of the method.

    ## Example
    `if image is None: image = np.zeros((480, 640, 3), np.uint8)`.

    ## Use instead
    `xpl.observation.get_image(obs, camera)`, which names the cameras that are there.

    ## Fix safety
    No automatic fix.
    """
    declared = source.manifest.get("inputs")
    optional = declared.get("optional") if isinstance(declared, dict) else None
    if isinstance(optional, list) and any(str(entry).startswith(f"{sdk.Obs.VISION}.") for entry in optional):
        raise NotApplicable("the manifest declares an optional camera, for which a stand-in may be meant")
    for function in Adapter.of(source).reach(*OBSERVING, *ACTING):
        for blank in blanks(function):
            if blank.is_image and not blank.is_masked:
                yield Finding(
                    f"a missing camera becomes a black image: the policy is blind where {blank.missing} is not found",
                    **source.at(function.file, blank.node),
                    expected="an error that names the cameras that are there",
                    got=ast.unparse(blank.node),
                    fix=Fix("advice", "raise, or declare the camera optional in policy.yml"),
                )
                break  # one stand-in of a function is like the next
