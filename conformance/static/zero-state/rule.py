"""XPL701: A state that an observation lacks is an error."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.fallbacks import zero_fallbacks
from xpl_cli.audit.static.model_class import ACTING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source

_OBSERVED: Final = frozenset((sdk.Obs.STATE, sdk.Payload.OBS, "observation", "proprio", "qpos"))
"""Words of a name that holds an observation, or a part of it."""


@rule(code="XPL701", requirement="XPL-OBS-3")
def zero_state(source: Source) -> Iterator[Finding]:
    """A state that an observation lacks is replaced by zeros.

    ## What it does
    Looks, in what observations pass through, for zeros that replace the result of a failed look-up in an observation or
    in its state. Not reported: zeros beside a mask, and inputs that the manifest declares optional.

    ## Why it matters
    All joints at zero is a pose like any other. The policy plans from where the robot is not, and nothing tells that a
    benchmark does not send what the policy was trained on.

    ## Example
    `state.get("arm_joint_state", np.zeros(7))`.

    ## Use instead
    `state["arm_joint_state"]`, which raises a KeyError; or declare the input optional in policy.yml.

    ## Fix safety
    No automatic fix.
    """
    inputs = source.manifest.inputs
    if inputs is not None and any(entry.startswith(f"{sdk.Obs.STATE}.") for entry in inputs.optional):
        return
    for function in ModelClass.of(source).reach(*OBSERVING, *ACTING):
        for blank in zero_fallbacks(function):
            if not blank.is_image and not blank.is_masked and _is_observed(blank.read):
                yield Finding(
                    f"if an observation lacks {blank.missing}, the policy acts as if all of it were zero",
                    **source.at(function.file, blank.node),
                    expected="an error that names the missing key",
                    got=ast.unparse(blank.node),
                    fix=Fix("advice", "read the key with [...], or raise an error"),
                )
                break  # one placeholder in a function is like the next


def _is_observed(name: str) -> bool:
    """Tell whether a map is an observation or its state, by the words of its name."""
    return bool(_OBSERVED & set(name.removesuffix("()").lower().replace(".", "_").split("_")))
