"""XPL186: Every camera that the policy reads is declared with the size of image that it needs."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.manifests import key_line
from xpl_cli.audit.static.source import Source

_NAME = sdk.File.POLICY_YML
_KEY = "cameras"


@rule(code="XPL186", requirement="XPL-CFG-13", after=("manifest",))
def camera_sizes(source: Source) -> Iterator[Finding]:
    """The manifest does not declare the image sizes that the policy needs.

    ## What it does
    Compares `cameras` in `policy.yml` with the cameras under `inputs.required` and `inputs.optional`: each of them has
    an entry, and no other camera has one.

    ## Why it matters
    A policy that was trained on 640 x 480 accepts an image of 64 x 48 without an error, and acts badly. Environments
    render images of the declared size, and benchmarks refuse others.

    ## Example
    `inputs: {required: [vision.cam_head]}` and `cameras: {}`.

    ## Use instead
    `cameras: {cam_head: {width: 640, height: 480}}`, with `exact: true` if no other size will do, and `width: null,
    height: null` if any will.

    ## Fix safety
    No automatic fix: only the author knows which size the policy needs. The entry of a camera that is not read can be
    deleted.
    """
    if source.is_ecosystem:
        raise NotApplicable("an adapter without policy.yml declares nothing")
    parts = (name.partition(".") for name in source.manifest.read)
    read = [camera for kind, _, camera in parts if kind == sdk.Obs.VISION]
    declared = source.manifest.cameras
    for camera in read:
        if camera not in declared:
            yield _finding(
                source,
                f"the image size of {camera} that the policy needs is not declared, although it is an input",
                expected=f"{camera}: {{width: ..., height: ...}}",
                got=", ".join(declared) or "no camera",
                fix=f"declare {camera} under {_KEY}, with null for width and height if any image will do",
            )
    for camera in declared:
        if camera not in read:
            yield _finding(
                source,
                (
                    f"{camera} is declared with a size, and not among the inputs: environments would render it "
                    "without need"
                ),
                expected=f"{sdk.Obs.VISION}.{camera} under inputs.required or inputs.optional",
                got="neither",
                fix=f"remove {camera} from {_KEY}, or list it as an input",
            )


def _finding(source: Source, message: str, expected: str, got: str, fix: str) -> Finding:
    return Finding(
        message,
        path=_NAME,
        line=key_line(source, _NAME, _KEY),
        column=1,
        expected=expected,
        got=got,
        fix=Fix("advice", fix),
    )
