"""XPL191: A swap of red and blue is declared."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.channels import channel_swaps
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import constant

_WORD = "bgr"
_ORDER = re.compile(r"colou?r|channel|bgr|rgb", re.IGNORECASE)


@rule(code="XPL191", requirement="XPL-OBS-7")
def undeclared_channel_swap(source: Source) -> Iterator[Finding]:
    """The red and blue channels of an observed image are swapped without a declaration.

    ## What it does
    Follows images of the observation, as `channel-swap` does, and reports every other swap of the channels: `[...,
    ::-1]`, `[..., [2, 1, 0]]`, `np.flip` over the last axis, `COLOR_RGB2BGR`. Some models do need BGR, and policy.yml
    has no key for it, so the word "bgr" counts as a declaration: in a name, comment or docstring of the function, in
    policy.yml or in deploy.yml. A swap for a video writer that needs BGR is not reported. A default in code that
    differs from the order in deploy.yml is reported too. It is a warning, since the rule does not know what the weights
    were trained on.

    ## Why it matters
    Images of the standard are RGB. Code left over from reading images with OpenCV gives the policy a blue cup in place
    of a red one; it still moves, only worse, and the cause is hard to find.

    ## Example
    `image = xpl.observation.get_image(obs, "cam_head")[..., ::-1]`.

    ## Use instead
    The image as it is. If the weights were trained on BGR, declare it: `bgr = image[..., ::-1] # trained on BGR`.

    ## Fix safety
    No automatic fix: weights that were trained on BGR images need BGR.
    """
    yield from _defaults(source)
    manifests = (source.text(name) for name in (sdk.File.POLICY_YML, sdk.File.DEPLOY_YML) if source.has(name))
    if any(_WORD in text.lower() for text in manifests):
        return
    for function in ModelClass.of(source).reach(*OBSERVING, *ACTING):
        for swap in channel_swaps(function):
            is_found_already = swap.claims_bgr or swap.decoded
            if swap.observed and not is_found_already and not _says_why(source, function):
                yield Finding(
                    (
                        "red and blue of an observation's image are swapped without a declaration that the model "
                        "needs BGR"
                    ),
                    **source.at(function.file, swap.node),
                    expected="an unchanged RGB image, or a declaration of BGR",
                    got=ast.unparse(swap.node),
                    fix=Fix(
                        "advice",
                        ("delete the swap; or, if the weights were trained on BGR, declare it in a comment beside it"),
                    ),
                )


def _defaults(source: Source) -> Iterator[Finding]:
    """Yield an order of channels that the code takes where deploy.yml, which says another one, lacks the key."""
    for setting in ModelClass.of(source).settings:
        read = setting.read
        default, configured = constant(read.default), source.deploy.get(read.key)
        if not isinstance(default, str) or not isinstance(configured, str) or not _ORDER.search(read.key):
            continue
        if default.lower() != configured.lower() and {default.lower(), configured.lower()} & {_WORD, "rgb"}:
            yield Finding(
                f"the default of {read.key} is {default}, but deploy.yml sets {configured}: without that line red and "
                "blue are swapped",
                **source.at(setting.function.file, read.node),
                expected=f"{configured!r}, or an error",
                got=repr(default),
                fix=Fix("advice", f"make the default {configured!r}"),
            )


def _says_why(source: Source, function: Function) -> bool:
    """Tell whether a function, or the line above it, speaks of BGR other than by the name of the conversion."""
    lines = source.text(function.file).split("\n")[max(function.node.lineno - 2, 0) : function.node.end_lineno]
    return _WORD in "\n".join(lines).replace("COLOR_RGB2BGR", "").lower()
