"""XPL124: A value that is missing from the model's output is an error."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.fallbacks import zero_fallbacks
from xpl_cli.audit.static.model_class import ACTING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source


@rule(code="XPL124", requirement="XPL-ACT-11")
def zero_action(source: Source) -> Iterator[Finding]:
    """A value that is missing from the model's output is replaced by zeros.

    ## What it does
    Looks in the functions that only `get_action` reaches for zeros that replace the result of a failed look-up.

    ## Why it matters
    All joints at zero is a pose like any other. A checkpoint with other key names sends the arm there at full speed.

    ## Example
    `action.get("left_arm", np.zeros((horizon, 6)))`.

    ## Use instead
    `action["left_arm"]`, which raises a KeyError.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    observing = {id(function.node) for function in adapter.reach(*OBSERVING)}
    for function in adapter.reach(*ACTING):
        if id(function.node) in observing:
            continue
        for blank in zero_fallbacks(function):
            if not blank.is_image and not blank.is_masked and _is_output(blank.read):
                yield Finding(
                    f"if the model's output lacks {blank.missing}, the robot is sent to zero",
                    **source.at(function.file, blank.node),
                    expected="an error that names the missing key",
                    got=ast.unparse(blank.node),
                    fix=Fix("advice", "read the key with [...], or raise an error"),
                )


def _is_output(name: str) -> bool:
    """Tell whether a map can be what a model answered: no observation, nothing that the adapter stored."""
    words = name.lower().split("_")
    observation_words = {sdk.Obs.STATE, sdk.Payload.OBS, "observation", "self", "cfg", "config"}
    return (
        bool(name) and not name.endswith("()") and not name.startswith("self.") and not observation_words & set(words)
    )
