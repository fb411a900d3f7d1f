"""XPL122: Data conversion and evaluation use the same channel order."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.colour import swaps
from xpl_cli.audit.static.source import Source


@rule(code="XPL122", requirement="XPL-IMG-3")
def conversion_channel_swap(source: Source) -> Iterator[Finding]:
    """Training data gets red and blue exchanged, and evaluation does not.

    ## What it does
    Reads the Python files that `process_data.sh` calls and looks for exchanges of the channels in frames of a
    trajectory, which are RGB once decoded. Frames that OpenCV read from a file or a video are BGR and may be exchanged.

    ## Why it matters
    The policy is trained on one order and evaluated on the other. It learns, and then fails on everything that is told
    apart by colour; nothing in the logs shows why.

    ## Example
    `decode_image_bit(frame)` followed by `cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)`: trajectories are encoded from RGB.

    ## Use instead
    `xpl.images.decode(data)` reads the marker of the file and gives RGB for both byte formats.

    ## Fix safety
    No automatic fix: data that was converted before has to be converted again.
    """
    if not source.conversion_files:
        raise NotApplicable("the adapter converts no data")
    for name in source.conversion_files:
        for function in source.functions(name):
            found = [swap for swap in swaps(function) if swap.claims_bgr or swap.decoded]
            if found:
                yield Finding(
                    f"{function.name} trains the policy on red and blue exchanged: evaluation shows it RGB",
                    **source.at(name, found[0].node),
                    expected="the order that evaluation uses, RGB",
                    got=ast.unparse(found[0].node),
                    fix=Fix("advice", "delete the exchange and convert the data again"),
                )
