"""XPL122: Data conversion and evaluation use the same channel order."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static import vendored
from xpl_cli.audit.static.channels import channel_swaps
from xpl_cli.audit.static.source import Source

_IMPORTED = re.compile(r"^\s*from (?:XPolicyLab|xpl)\b", re.MULTILINE)


@rule(code="XPL122", requirement="XPL-IMG-3")
def conversion_channel_swap(source: Source) -> Iterator[Finding]:
    """Data conversion swaps the red and blue channels, and evaluation does not.

    ## What it does
    Reads the Python files that `process_data.sh` runs, and files of vendored code that import the ecosystem's helpers
    and decode frames with them. Looks for channel swaps in frames of a trajectory, which are RGB after decoding. Frames
    that OpenCV read from a file or a video are BGR and may be swapped.

    ## Why it matters
    The policy is trained on one channel order and evaluated on the other. It learns, and then fails on every task that
    depends on colour; the logs do not show why.

    ## Example
    `decode_image_bit(frame)` followed by `cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)`: trajectories are encoded from RGB.

    ## Use instead
    `xpl.image_codec.decode(data)` reads the format marker and returns RGB for both byte formats.

    ## Fix safety
    No automatic fix: data that was already converted has to be converted again.
    """
    readers = _readers(source)
    if not source.conversion_files and not readers:
        raise NotApplicable("the adapter converts no data")
    for name in (*source.conversion_files, *readers):
        for function in source.functions(name):
            swaps = [
                swap for swap in channel_swaps(function) if swap.decoded or (swap.claims_bgr and name not in readers)
            ]
            if swaps:
                yield Finding(
                    f"{function.name} trains the policy on red and blue swapped: in evaluation it gets RGB",
                    **source.at(name, swaps[0].node),
                    expected="the order that evaluation uses, RGB",
                    got=ast.unparse(swaps[0].node),
                    fix=Fix("advice", "delete the swap and convert the data again"),
                )


def _readers(source: Source) -> tuple[str, ...]:
    """Return files of vendored trees that decode the ecosystem's frames: what the adapter's author put there."""
    conversion_files = set(source.conversion_files)
    return tuple(
        name
        for name, text in vendored.texts(source)
        if name.endswith(".py") and "decode_image" in text and _IMPORTED.search(text) and name not in conversion_files
    )
