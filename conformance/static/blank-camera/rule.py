"""XPL123: A camera that is missing is an error."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.adapter import ACTING, OBSERVING, Adapter
from xpl_cli.audit.static.blanks import Blank, blanks
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import assigned, called, texts

_CAMERA = "cam_"
"""How the names of cameras begin in the standard."""


@rule(code="XPL123", requirement="XPL-OBS-3")
def blank_camera(source: Source) -> Iterator[Finding]:
    """A camera that is missing becomes a black image.

    ## What it does
    Looks in what the observing and acting methods reach for images of zeros that stand in where a look-up found
    nothing. Where policy.yml declares a camera optional, a stand-in may be meant, and nothing is reported. It is a
    warning where the function also makes masks, and where a view is lacking in a map that the function itself makes for
    the model: then the model may have more views than the robot, and be told so. A view there whose name is none of the
    standard's is the model's own placeholder.

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
    inputs = source.manifest.inputs
    if inputs is not None and any(entry.startswith(f"{sdk.Obs.VISION}.") for entry in inputs.optional):
        raise NotApplicable("the manifest declares an optional camera, for which a stand-in may be meant")
    for function in Adapter.of(source).reach(*OBSERVING, *ACTING):
        for blank in blanks(function):
            if blank.is_image and not blank.is_masked and not _is_of_model(blank):
                doubt = _doubt(blank)
                yield Finding(
                    f"a missing camera becomes a black image: the policy is blind where {blank.missing} is not found"
                    f"{doubt}",
                    **source.at(function.file, blank.node),
                    expected="an error that names the cameras that are there",
                    got=ast.unparse(blank.node),
                    fix=Fix("advice", "raise, or declare the camera optional in policy.yml"),
                    must=False if doubt else None,
                )
                break  # one stand-in of a function is like the next


def _doubt(blank: Blank) -> str:
    """Return why a stand-in may be a placeholder that the model knows as such; empty if it is none."""
    words = {node.id for node in blank.function.of(ast.Name)} | {node.attr for node in blank.function.of(ast.Attribute)}
    words |= {text for node in blank.function.of(ast.Dict) for key in node.keys if key for text in texts(key)}
    if any("mask" in word.lower() for word in words):
        return f"; whether a mask of {blank.function.name} hides it cannot be told"
    if _is_made_here(blank):
        return f"; whether the model takes it for a view that a robot may lack in {blank.read} cannot be told"
    return ""


def _is_made_here(blank: Blank) -> bool:
    """Tell whether the function itself makes the map that lacks the view."""
    made = assigned(blank.function.of(ast.Assign)).get(blank.read)
    return isinstance(made, ast.Dict) or (isinstance(made, ast.Call) and called(made) == "dict" and not made.args)


def _is_of_model(blank: Blank) -> bool:
    """Tell whether what lacks is an input of the model under its own name, which no observation has."""
    named = blank.missing[:1] in {"'", '"'}
    return named and _CAMERA not in blank.missing and _is_made_here(blank)
