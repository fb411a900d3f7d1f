"""Rules: how one is declared, and where all of them are found."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from xpl_cli import content, spec
from xpl_cli.audit.model import Finding, Gate
from xpl_cli.errors import UserError

Check = Callable[..., Iterator[Finding]]


@dataclass(frozen=True)
class Rule:
    """One check of one requirement.

    Attributes:
        code: `XPL1xx` static, `XPL2xx` offline, `XPL3xx` MuJoCo, `XPL4xx` environment packages.
        slug: name for people; the rule's folder in `conformance/`.
        gate: where it runs.
        requirement: id of what it proves; its level gives the severity.
        target: kind of package it looks at, `policy` or `env`.
        check: the function; its parameters name the facts it needs.
        folder: the rule's folder.
    """

    code: str
    slug: str
    gate: Gate
    requirement: str
    target: str
    check: Check
    folder: Path

    @property
    def severity(self) -> str:
        """`must` or `should`, from the requirement."""
        return spec.requirements()[self.requirement].level.lower()

    @property
    def documentation(self) -> str:
        """The docstring: a summary line, then sections with fixed headings."""
        return inspect.getdoc(self.check) or ""

    @property
    def summary(self) -> str:
        """First line of the documentation."""
        return self.documentation.partition("\n")[0]


def rule(*, code: str, slug: str, gate: str, requirement: str, target: str = "policy") -> Callable[[Check], Check]:
    """Declare a check as a rule. The decorated generator yields a `Finding` for every fault.

    Its docstring is what `xpl explain` prints: a summary line, then the headings What it does, Why it matters, Example,
    Use instead, Fix safety.
    """

    def declare(check: Check) -> Check:
        folder = Path(inspect.getfile(check)).parent
        declared = Rule(code, slug, Gate(gate), requirement, target, check, folder)
        check.__dict__["xpl_rule"] = declared
        return check

    return declare


@cache
def rules() -> tuple[Rule, ...]:
    """Return every rule of the conformance room, in order of code."""
    found = [_declared(path) for path in sorted(content.room("conformance").glob("*/rule.py"))]
    return tuple(sorted(found, key=lambda item: item.code))


def find(name: str) -> Rule:
    """Return a rule by code or slug.

    Raises:
        UserError: with the nearest names.
    """
    import difflib

    names: dict[str, Rule] = {key: item for item in rules() for key in (item.code, item.slug)}
    wanted = name.upper() if name.upper() in names else name.lower()
    if wanted in names:
        return names[wanted]
    near = difflib.get_close_matches(wanted, names, n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(near)}?" if near else "`xpl rules` lists them"
    raise UserError(f"there is no rule {name!r}", hint=hint)


def select(names: tuple[str, ...], ignore: tuple[str, ...] = ()) -> tuple[Rule, ...]:
    """Return the rules that a selection of codes, code prefixes and slugs leaves; an empty one selects all.

    Raises:
        UserError: if a name selects nothing.
    """
    chosen = [item for item in rules() if not names or any(_matches(item, name) for name in names)]
    for name in (*names, *ignore):
        if not any(_matches(item, name) for item in rules()):
            find(name)
    return tuple(item for item in chosen if not any(_matches(item, name) for name in ignore))


def _matches(item: Rule, name: str) -> bool:
    return item.slug == name or (name.upper().startswith("XPL") and item.code.startswith(name.upper()))


def _declared(path: Path) -> Rule:
    module: Any = content.load_module(path)
    declared = [value.xpl_rule for value in vars(module).values() if hasattr(value, "xpl_rule")]
    if len(declared) != 1:
        message = f"{path} must declare exactly one rule, found {len(declared)}"
        raise RuntimeError(message)
    result: Rule = declared[0]
    return result
