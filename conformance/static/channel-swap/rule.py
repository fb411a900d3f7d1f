"""XPL121: Images are RGB from the environment to the model."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.channels import channel_swaps
from xpl_cli.audit.static.model_class import ACTING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source


@rule(code="XPL121", requirement="XPL-IMG-1")
def channel_swap(source: Source) -> Iterator[Finding]:
    """The adapter swaps the red and blue channels of images that are RGB.

    ## What it does
    Follows the observation through `update_obs` and looks for swaps of the channels: `cvtColor` from BGR, although
    images of the standard are RGB, and any swap directly after decoding. Not reported: a swap that a setting switches
    on, or one for a video writer that needs BGR. `undeclared-channel-swap` reports other swaps.

    ## Why it matters
    The policy sees a blue cup where a red one stands. If only encoded frames are swapped, the colours depend on the
    image transport.

    ## Example
    `cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)` for frames that were encoded from RGB.

    ## Use instead
    `xpl.observation.get_image(obs, camera)`, which is RGB for every image transport.

    ## Fix safety
    No automatic fix: weights that were trained on BGR images need BGR.
    """
    for function in ModelClass.of(source).reach(*OBSERVING, *ACTING):
        for swap in channel_swaps(function):
            if swap.claims_bgr or swap.decoded:
                way = "frames that arrive encoded have" if swap.decoded else "every frame has"
                yield Finding(
                    f"{way} red and blue swapped: the policy gets a blue cup in place of a red one",
                    **source.at(function.file, swap.node),
                    expected="RGB as it arrives",
                    got=ast.unparse(swap.node),
                    fix=Fix("advice", "delete the swap; read images with xpl.observation.get_image"),
                )
