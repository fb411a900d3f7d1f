"""XPL123: A missing camera is an error."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.fallbacks import ZeroFallback, zero_fallbacks
from xpl_cli.audit.static.model_class import ACTING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import assigned, called, texts

_CAMERA = "cam_"
"""How the names of cameras begin in the standard."""


@rule(code="XPL123", requirement="XPL-OBS-3")
def blank_camera(source: Source) -> Iterator[Finding]:
    """A missing camera is replaced by a black image.

    ## What it does
    Looks in what `update_obs` and `get_action` reach for images of zeros that replace a camera which a look-up did not
    find. Not reported if policy.yml declares a camera optional. It is a warning if the function also makes masks, or if
    the missing view belongs to a dict that the function builds for the model: the model may have more views than the
    robot, and masks for them. A view whose name is not a camera of the standard is the model's own placeholder.

    ## Why it matters
    With a misspelt camera name, or an environment without that camera, the policy gets black images. It still moves,
    and its low score looks like a property of the method.

    ## Example
    `if image is None: image = np.zeros((480, 640, 3), np.uint8)`.

    ## Use instead
    `xpl.observation.get_image(obs, camera)`, whose error lists the cameras of the observation.

    ## Fix safety
    No automatic fix.
    """
    inputs = source.manifest.inputs
    if inputs is not None and any(entry.startswith(f"{sdk.Obs.VISION}.") for entry in inputs.optional):
        raise NotApplicable("the manifest declares an optional camera, which the black image may replace on purpose")
    for function in ModelClass.of(source).reach(*OBSERVING, *ACTING):
        for blank in zero_fallbacks(function):
            if blank.is_image and not blank.is_masked and not _is_of_model(blank):
                doubt = _doubt(blank)
                yield Finding(
                    f"a missing camera becomes a black image: the policy gets no image if {blank.missing} is "
                    f"missing{doubt}",
                    **source.at(function.file, blank.node),
                    expected="an error that lists the existing cameras",
                    got=ast.unparse(blank.node),
                    fix=Fix("advice", "raise an error, or declare the camera optional in policy.yml"),
                    must=False if doubt else None,
                )
                break  # one stand-in of a function is like the next


def _doubt(blank: ZeroFallback) -> str:
    """Return why a stand-in may be a placeholder that the model knows as such; empty if it is none."""
    words = {node.id for node in blank.function.of(ast.Name)} | {node.attr for node in blank.function.of(ast.Attribute)}
    words |= {text for node in blank.function.of(ast.Dict) for key in node.keys if key for text in texts(key)}
    if any("mask" in word.lower() for word in words):
        return f"; a mask of {blank.function.name} may hide it"
    if _is_made_here(blank):
        return f"; the model may know it as a view that a robot may lack in {blank.read}"
    return ""


def _is_made_here(blank: ZeroFallback) -> bool:
    """Tell whether the function itself makes the map that lacks the view."""
    made = assigned(blank.function.of(ast.Assign)).get(blank.read)
    return isinstance(made, ast.Dict) or (isinstance(made, ast.Call) and called(made) == "dict" and not made.args)


def _is_of_model(blank: ZeroFallback) -> bool:
    """Tell whether what lacks is an input of the model under its own name, which no observation has."""
    named = blank.missing[:1] in {"'", '"'}
    return named and _CAMERA not in blank.missing and _is_made_here(blank)
