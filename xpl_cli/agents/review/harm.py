"""The consequences of violated requirements, worst first: the order of findings in a review.

The requirements have no order; this judgement is made here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Harm:
    """A kind of consequence.

    Attributes:
        name: in JSON.
        sentence: in text.
        requirements: ids, or prefixes of ids, of the standard.
    """

    name: str
    sentence: str
    requirements: tuple[str, ...]


HARMS: Final = (
    Harm(
        "damages",
        "leaks, deletes or runs what it must not",
        ("XPL-PKG-3", "XPL-PKG-11", "XPL-PKG-12", "XPL-SRV-4", "XPL-SRV-9", "XPL-ENV-12"),
    ),
    Harm(
        "moves-wrongly", "sends a robot the wrong commands", ("XPL-ACT", "XPL-SIM", "XPL-BAT", "XPL-NAT-1", "XPL-NAT-3")
    ),
    Harm(
        "deceives",
        "seems to work, and its results are wrong",
        (
            *("XPL-IMG", "XPL-OBS", "XPL-EPI", "XPL-CKP", "XPL-LOOP", "XPL-DAT", "XPL-CON-6", "XPL-CFG", "XPL-ENV"),
            "XPL-NAT",
        ),
    ),
    Harm(
        "breaks",
        "does not run, or not everywhere",
        (
            *("XPL-CON", "XPL-SRV", "XPL-PKG-1", "XPL-PKG-2", "XPL-PKG-4"),
            *("XPL-CFG-1", "XPL-CFG-5", "XPL-CFG-10", "XPL-ENV-1", "XPL-ENV-2", "XPL-ENV-6"),
        ),
    ),
    Harm("costs", "makes the package harder to keep", ("XPL-PKG", "XPL-AUD", "XPL-ADV")),
)
"""All kinds, worst first. The longest matching prefix of an id counts."""


def harm(requirement: str) -> tuple[int, Harm]:
    """Return the rank (0 is worst) and kind of harm of violating a requirement."""
    fits = [
        (len(name), -rank)
        for rank, kind in enumerate(HARMS)
        for name in kind.requirements
        if requirement == name or requirement.startswith(f"{name}-")
    ]
    # A requirement without a kind is reported last, not omitted.
    rank = -max(fits)[1] if fits else len(HARMS) - 1
    return rank, HARMS[rank]
