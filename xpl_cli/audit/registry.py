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


# The hundred of a code names its gate, so that the rules of gates that do not run need not be imported.
_GATES = {"1": (Gate.STATIC,), "2": (Gate.OFFLINE,), "3": (Gate.MUJOCO,), "4": tuple(Gate)}


@dataclass(frozen=True)
class Entry:
    """What is known of a rule without importing it: its folder is its slug, its file begins with its code."""

    code: str
    slug: str
    path: Path

    @property
    def gates(self) -> tuple[Gate, ...]:
        """The gates that a rule of this code may run in."""
        return _GATES[self.code.removeprefix("XPL")[0]]

    def load(self) -> Rule:
        """Import the rule."""
        return _declared(self.path)


@cache
def entries() -> tuple[Entry, ...]:
    """Return every rule of the conformance room, not imported, in order of code."""
    paths = content.room("conformance").glob("*/rule.py")
    return tuple(
        sorted((Entry(_first_word(path), path.parent.name, path) for path in paths), key=lambda item: item.code)
    )


def rules() -> tuple[Rule, ...]:
    """Return every rule of the conformance room, in order of code."""
    return tuple(entry.load() for entry in entries())


def find(name: str) -> Rule:
    """Return a rule by code or slug.

    Raises:
        UserError: with the nearest names.
    """
    import difflib

    names = {key: entry for entry in entries() for key in (entry.code, entry.slug)}
    wanted = name.upper() if name.upper() in names else name.lower()
    if wanted in names:
        return names[wanted].load()
    near = difflib.get_close_matches(wanted, names, n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(near)}?" if near else "`xpl rules` lists them"
    raise UserError(f"there is no rule {name!r}", hint=hint)


def select(names: tuple[str, ...], ignore: tuple[str, ...], gates: tuple[Gate, ...]) -> tuple[Rule, ...]:
    """Return the rules of some gates that a selection leaves.

    Args:
        names: codes, code prefixes and slugs to run; empty for all.
        ignore: codes, code prefixes and slugs to leave out.
        gates: the gates.

    Raises:
        UserError: if a name stands for no rule.
    """
    for name in (*names, *ignore):
        if not any(_matches(entry, name) for entry in entries()):
            find(name)
    chosen = [
        entry.load()
        for entry in entries()
        if set(entry.gates) & set(gates)
        and (not names or any(_matches(entry, name) for name in names))
        and not any(_matches(entry, name) for name in ignore)
    ]
    return tuple(rule for rule in chosen if rule.gate in gates)


def _matches(entry: Entry, name: str) -> bool:
    return entry.slug == name or (name.upper().startswith("XPL") and entry.code.startswith(name.upper()))


def _first_word(path: Path) -> str:
    """Return the code with which the docstring of a rule's file begins."""
    with path.open(encoding="utf-8") as stream:
        return stream.readline().removeprefix('"""').partition(":")[0]


def _declared(path: Path) -> Rule:
    module: Any = content.load_module(path)
    declared = [value.xpl_rule for value in vars(module).values() if hasattr(value, "xpl_rule")]
    if len(declared) != 1:
        message = f"{path} must declare exactly one rule, found {len(declared)}"
        raise RuntimeError(message)
    result: Rule = declared[0]
    return result
