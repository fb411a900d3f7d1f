"""XPL121: Images are RGB from the environment to the model."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import ACTING, OBSERVING, Adapter
from xpl_cli.audit.static.colour import swaps
from xpl_cli.audit.static.source import Source


@rule(code="XPL121", requirement="XPL-IMG-1")
def channel_swap(source: Source) -> Iterator[Finding]:
    """The adapter exchanges red and blue in images that are RGB.

    ## What it does
    Follows the observation through the observing methods and looks for exchanges of the channels: `cvtColor` from BGR,
    which images of the standard never are, and any exchange right after decoding. An exchange that hangs on a setting,
    or that goes to a writer which wants BGR, does not count. Other exchanges are left to `undeclared-channel-swap`.

    ## Why it matters
    The policy sees a blue cup where a red one stands. A branch for encoded frames only makes it worse: the colours then
    depend on how the image travelled.

    ## Example
    `cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)` for frames that were encoded from RGB.

    ## Use instead
    `xpl.observation.get_image(obs, camera)`, which is RGB whatever the transport was.

    ## Fix safety
    No automatic fix: weights that were trained on exchanged channels need them so.
    """
    for function in Adapter.of(source).reach(*OBSERVING, *ACTING):
        for swap in swaps(function):
            if swap.claims_bgr or swap.decoded:
                way = "frames that arrive encoded have" if swap.decoded else "every frame has"
                yield Finding(
                    f"{way} red and blue exchanged: the policy sees a blue cup where a red one stands",
                    **source.at(function.file, swap.node),
                    expected="RGB as it arrives",
                    got=ast.unparse(swap.node),
                    fix=Fix("advice", "delete the exchange; take images with xpl.observation.get_image"),
                )
