"""Harm: what a package does that violates a requirement. Reports list findings by it, the worst first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from xpl_cli.standard import spec


@dataclass(frozen=True, order=True)
class Harm:
    """A kind of consequence.

    Attributes:
        rank: its place among all kinds; 0 is worst.
        name: in JSON.
        sentence: what the package does, without a subject.
    """

    rank: int
    name: str
    sentence: str

    @classmethod
    def of(cls, requirement: str) -> Self:
        """Return the harm of violating a requirement; the least one if the requirement is not known."""
        kinds = list(spec.harms())
        known = spec.requirements().get(requirement)
        name = known.harm if known is not None and known.harm in kinds else kinds[-1]
        return cls(kinds.index(name), name, spec.harms()[name])
