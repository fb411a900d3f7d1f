"""Rules that are gone: their codes, which are not used again, why they went, and what proves the same now."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

from xpl_cli.basics import content
from xpl_cli.basics.yaml import text as yaml_text

FILE: Final = "retired.yml"
"""In the conformance room."""


@dataclass(frozen=True)
class Retired:
    """One rule that is gone.

    Attributes:
        code, slug: what it was called; neither is used again.
        found: what it reported, a sentence.
        reason: why it is gone, a sentence.
        proven_by: codes of rules that prove the same by running; empty where none does.
    """

    code: str
    slug: str
    found: str
    reason: str
    proven_by: tuple[str, ...]

    @property
    def documentation(self) -> str:
        """What `xpl explain` prints of it: Markdown."""
        return f"It reported: {self.found}\n\n{self.reason}\n\n{self.instead}"

    @property
    def instead(self) -> str:
        """What proves the same now, a sentence."""
        return f"By running, {', '.join(self.proven_by)} proves it." if self.proven_by else "No other rule proves it."

    @property
    def text(self) -> str:
        """What is said of it where its name is given."""
        return f"{self.code} {self.slug} is retired. {self.reason} {self.instead}"


@cache
def retired() -> tuple[Retired, ...]:
    """Return every rule that is gone, in order of code."""
    entries = yaml_text.parse((content.room("conformance") / FILE).read_bytes())["retired"]
    return tuple(
        Retired(entry["code"], entry["slug"], entry["found"], entry["reason"], tuple(entry["proven_by"]))
        for entry in entries
    )


def lookup(name: str) -> Retired | None:
    """Return the retired rule of this code or slug, None if there was none."""
    return next((entry for entry in retired() if name.lower() in {entry.code.lower(), entry.slug}), None)
