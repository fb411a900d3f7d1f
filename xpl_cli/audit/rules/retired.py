"""Retired rules with the reason and the rules that replace them, and former slugs of rules that were renamed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from xpl_cli.basics import content
from xpl_cli.basics.yaml import text as yaml_text

FILE: Final = "retired.yml"
"""File in the folder `conformance`."""


@dataclass(frozen=True)
class Retired:
    """A retired rule.

    Attributes:
        code, slug: its names; neither is used again.
        found: what it reported, a sentence.
        reason: why it was retired, a sentence.
        proven_by: codes of rules that prove the same by running the adapter; may be empty.
    """

    code: str
    slug: str
    found: str
    reason: str
    proven_by: tuple[str, ...]

    @property
    def documentation(self) -> str:
        """The text that `xpl explain` prints, in Markdown."""
        return f"It reported: {self.found}\n\n{self.reason}\n\n{self.instead}"

    @property
    def instead(self) -> str:
        """Which rules prove the same, a sentence."""
        return f"By running, {', '.join(self.proven_by)} proves it." if self.proven_by else "No other rule proves it."

    @property
    def text(self) -> str:
        """The message for a user who names this rule."""
        return f"{self.code} {self.slug} is retired. {self.reason} {self.instead}"


@cache
def _content() -> dict[str, Any]:
    parsed: dict[str, Any] = yaml_text.parse((content.content_folder("conformance") / FILE).read_bytes())
    return parsed


@cache
def retired() -> tuple[Retired, ...]:
    """Return every retired rule, in order of code."""
    entries = _content()["retired"]
    return tuple(
        Retired(entry["code"], entry["slug"], entry["found"], entry["reason"], tuple(entry["proven_by"]))
        for entry in entries
    )


def lookup(name: str) -> Retired | None:
    """Return the retired rule with this code or slug, or None."""
    return next((entry for entry in retired() if name.lower() in {entry.code.lower(), entry.slug}), None)


def renamed() -> dict[str, str]:
    """Return the codes of renamed rules by their former slugs."""
    codes: dict[str, str] = _content()["renamed"]
    return codes


def current(name: str) -> str:
    """Return the code of a rule whose former slug this is; any other name unchanged."""
    return renamed().get(name.lower(), name)
