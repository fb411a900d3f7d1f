"""XPL122: Data conversion and evaluation use the same channel order."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static import vendored
from xpl_cli.audit.static.colour import swaps
from xpl_cli.audit.static.source import Source

_IMPORTED = re.compile(r"^\s*from (?:XPolicyLab|xpl)\b", re.MULTILINE)


@rule(code="XPL122", requirement="XPL-IMG-3")
def conversion_channel_swap(source: Source) -> Iterator[Finding]:
    """Training data gets red and blue exchanged, and evaluation does not.

    ## What it does
    Reads the Python files that `process_data.sh` calls, and files of vendored trees that import the ecosystem's helpers
    and decode frames by them, and looks for exchanges of the channels in frames of a trajectory, which are RGB once
    decoded. Frames that OpenCV read from a file or a video are BGR and may be exchanged.

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
    readers = _readers(source)
    if not source.conversion_files and not readers:
        raise NotApplicable("the adapter converts no data")
    for name in (*source.conversion_files, *readers):
        for function in source.functions(name):
            found = [swap for swap in swaps(function) if swap.decoded or (swap.claims_bgr and name not in readers)]
            if found:
                yield Finding(
                    f"{function.name} trains the policy on red and blue exchanged: evaluation shows it RGB",
                    **source.at(name, found[0].node),
                    expected="the order that evaluation uses, RGB",
                    got=ast.unparse(found[0].node),
                    fix=Fix("advice", "delete the exchange and convert the data again"),
                )


def _readers(source: Source) -> tuple[str, ...]:
    """Return files of vendored trees that decode the ecosystem's frames: what the adapter's author put there."""
    known = set(source.conversion_files)
    return tuple(
        name
        for name, text in vendored.texts(source)
        if name.endswith(".py") and "decode_image" in text and _IMPORTED.search(text) and name not in known
    )
