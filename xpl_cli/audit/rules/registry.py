"""Rules: how one is declared, and where all of them are found."""

from __future__ import annotations

import inspect
import re
import string
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Final, Self

from xpl import registry
from xpl_cli.audit.rules import retired
from xpl_cli.audit.rules.gates import DataGate, Gate
from xpl_cli.audit.rules.model import Finding, Proof
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.basics import content
from xpl_cli.basics.errors import UserError, no_such
from xpl_cli.standard import spec

Check = Callable[..., Iterator[Finding | Proof]]


OUR_CODES: Final = "XPL"
"""What the codes of our rules begin with, and those of no package."""
_CODE: Final = re.compile(r"[A-Z]{2,12}[1-9][0-9]{2}")


class RegistryError(Exception):
    """The rules contradict each other; a mistake in the conformance room, or of a package that brings rules."""


@dataclass(frozen=True)
class Rule:
    """One check of one requirement.

    Attributes:
        code: `XPL1xx` and `XPL7xx` static, `XPL2xx` offline, `XPL3xx` MuJoCo, `XPL4xx` environment packages,
            `XPL5xx` the audit itself, `XPL6xx` advice of general tools; a package's rules have other letters.
        slug: name for people; the rule's folder in `GATE/`.
        gate: where it runs; the first where it runs in several.
        requirement: id of what it proves; its level gives the severity.
        target: kind of package it looks at, `policy` or `env`.
        check: the function; its parameters name the facts it needs.
        folder: the rule's folder.
        after: slugs of rules of the same gate that have to hold first; where one does not, this one is not run.
        profile: the smaller profile that requires it: `shadow` where it holds of any model, so that both profiles
            require it; `full` where it judges the values that the real model answers.
        compares: whether it passes because answers are alike, which proves nothing of a policy that answers the same
            whatever it is shown.
        tries: what it tries, as a noun phrase, such as `batches that shrink`; several rules may share one. Empty for
            what its requirement is about, as with all rules that only read files.
        handler: the method that its findings are about where nothing was raised; empty for the one that answered last.
        loads: whether it judges what loading the model does, besides the adapter's other code: a pass proves nothing
            in shadow mode.
    """

    code: str
    slug: str
    gate: Gate
    requirement: str
    target: str
    check: Check
    folder: Path
    after: tuple[str, ...] = ()
    profile: Profile = Profile.SHADOW
    compares: bool = False
    tries: str = ""
    handler: str = ""
    loads: bool = False

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


# A rule's gate is where it lies: the folder of `conformance/` with the gates whose rules it may hold.
_FILES = "*/*/rule.py"
_FOLDERS = {
    "static": (Gate.STATIC,),
    "offline": (Gate.OFFLINE,),
    "demonstrations": (Gate.OFFLINE,),
    "mujoco": (Gate.MUJOCO,),
    "environments": tuple(Gate),
    "audit": tuple(Gate),
    "advice": (Gate.STATIC,),
}
_ENVIRONMENTS, _EVERY_GATE, _DEMONSTRATIONS, ADVICE = "environments", "audit", "demonstrations", "advice"
"""Folders: rules about environment packages; rules that judge the audit of any gate, after all others of it; rules that
run only where there are demonstrations, so that without any no report is another one; and rules that run only where
they are selected, because what they say depends on tools that may not be installed."""


def rule(  # noqa: PLR0913 - what a rule says of itself
    *,
    code: str,
    requirement: str,
    gate: str | None = None,
    after: tuple[str, ...] = (),
    profile: str = "shadow",
    compares: bool = False,
    tries: str = "",
    handler: str = "",
    loads: bool = False,
) -> Callable[[Check], Check]:
    """Declare a check as a rule. The decorated generator yields a `Finding` for every fault.

    It may yield a `Proof` of what it found right.
    Its docstring is what `xpl explain` prints: a summary line, then the headings What it does, Why it matters, Example,
    Use instead, Fix safety. Its folder `conformance/GATE/SLUG` says what it is called and where it runs; a rule of
    `environments/` or `audit/` says by `gate` in which one first. `after` names rules of the same gate without which
    this one would prove nothing; `profile="full"` says that only the real model can satisfy or break it; `compares`
    says that it passes because answers are alike, `loads` that it judges what loading the model does. `tries` says in a
    noun phrase what it tries, for the report's line of what was tried; `handler` names the method of the adapter whose
    line a finding gets if nothing was raised, if that is not the one which answered last.

    Raises:
        RegistryError: if it says another gate than its folder, or none where the folder leaves it open.
    """

    def declare(check: Check) -> Check:
        entry = RuleEntry.at(Path(inspect.getfile(check)), code)
        check.__dict__["xpl_rule"] = Rule(
            code,
            entry.slug,
            entry.gate(gate),
            requirement,
            entry.target,
            check,
            entry.path.parent,
            after,
            Profile(profile),
            compares,
            tries,
            handler,
            loads,
        )
        return check

    return declare


@dataclass(frozen=True)
class RuleEntry:
    """What is known of a rule without importing it, as those of gates that do not run are not.

    Attributes:
        code: with which its file begins.
        slug, folder: the names of its folder and of the one above: `conformance/FOLDER/SLUG/rule.py`.
        path: its file.
        source: the entry point of the package that brings it, None for ours.
    """

    code: str
    slug: str
    folder: str
    path: Path
    source: registry.RegisteredEntry | None = None

    @classmethod
    def of_package(cls, path: Path, source: registry.RegisteredEntry) -> Self:
        """Return what the place of a rule's file in an installed package says.

        Raises:
            EntryPointError: there are no rules in such a folder, or its file begins with no code for it.
        """
        try:
            entry = replace(cls.at(path), source=source)
        except (RegistryError, OSError, UnicodeDecodeError) as error:
            raise source.unusable(str(error)) from None
        if not _CODE.fullmatch(entry.code) or entry.code.startswith(OUR_CODES):
            raise source.unusable(
                f"{path} begins with the code {entry.code!r:.40}: expected letters and three digits, such as TINY101, "
                f"and not {OUR_CODES}, which is ours"
            )
        return entry

    @property
    def origin(self) -> str:
        """The distribution that brings it."""
        return registry.BUILT_IN_DISTRIBUTION if self.source is None else self.source.distribution

    @classmethod
    def at(cls, path: Path, code: str | None = None) -> Self:
        """Return what the place of a rule's file says.

        Args:
            path: the file `conformance/GATE/SLUG/rule.py`.
            code: the rule's code; read from the file by default.

        Raises:
            RegistryError: if there are no rules in such a folder.
        """
        slug, folder = path.parent.name, path.parent.parent.name
        if folder not in _FOLDERS:
            raise RegistryError(f"{path} is in none of the folders of rules: {', '.join(_FOLDERS)}")
        return cls(_read_code(path) if code is None else code, slug, folder, path)

    @property
    def gates(self) -> tuple[Gate, ...]:
        """The gates that a rule of this folder may run in."""
        return _FOLDERS[self.folder]

    @property
    def target(self) -> str:
        """The kind of package that it looks at, `policy` or `env`."""
        return "env" if self.folder == _ENVIRONMENTS else "policy"

    def gate(self, declared: str | None) -> Gate:
        """Return the gate of the rule, the first that it runs in.

        Args:
            declared: what the rule says of it.

        Raises:
            RegistryError: if that is not what its folder leaves open.
        """
        if (declared is None) != (len(self.gates) == 1):
            problem = "its folder says the gate" if declared else "its folder leaves the gate open: give gate="
            raise RegistryError(f"{self.path}: {problem}")
        return self.gates[0] if declared is None else Gate(declared)

    def runs_in(self, gate: Gate | DataGate) -> bool:
        """Tell whether the rule runs in a gate; imports it only where its folder leaves that open."""
        if self.folder == _ENVIRONMENTS:
            return self.load().gate == gate
        return gate in self.gates

    @property
    def closes(self) -> bool:
        """Whether it judges the audit of a gate, after all other rules of it."""
        return self.folder == _EVERY_GATE

    @property
    def needs_demonstrations(self) -> bool:
        """Whether it holds a policy against recorded episodes, and runs only where there are some or it is selected."""
        return self.folder == _DEMONSTRATIONS

    @property
    def is_advice(self) -> bool:
        """Whether it hands on what another tool says, and runs only where it is selected."""
        return self.folder == ADVICE

    def load(self) -> Rule:
        """Import the rule.

        Raises:
            EntryPointError: it is a package's, and cannot be imported, or says another code than its first line.
        """
        if self.source is None:
            return _load_rule(self.path)
        try:
            rule = _load_rule(self.path)
        except Exception as error:
            raise self.source.unusable(f"{self.path}: {type(error).__name__}: {error}") from error
        if rule.code != self.code:
            raise self.source.unusable(f"{self.path} begins with {self.code}, and declares {rule.code}")
        return rule


@cache
def builtin_entries() -> tuple[RuleEntry, ...]:
    """Return every rule of the conformance room, not imported, in order of code."""
    paths = content.content_folder("conformance").glob(_FILES)
    return tuple(sorted(map(RuleEntry.at, paths), key=lambda item: item.code))


@cache
def entries() -> tuple[RuleEntry, ...]:
    """Return every rule, ours and those of installed packages, not imported, in order of code.

    Raises:
        EntryPointError: a package's cannot be used, or has a code or a name that another rule has.
    """
    by_name = {name: entry for entry in builtin_entries() for name in (entry.code, entry.slug)}
    added = []
    for folder, source in registry.folders(registry.RULES).items():
        for path in sorted(folder.glob(_FILES)):
            entry = RuleEntry.of_package(path, source)
            for name in (entry.code, entry.slug):
                other = by_name.setdefault(name, entry)
                if other is not entry:
                    raise source.unusable(f"{path} and {other.path} of {other.origin} are both called {name}")
            added.append(entry)
    return tuple(sorted((*builtin_entries(), *added), key=lambda item: item.code))


def rules() -> tuple[Rule, ...]:
    """Return every rule, ours and those of installed packages, in order of code."""
    return tuple(entry.load() for entry in entries())


def find(name: str) -> Rule:
    """Return a rule by code or slug; a renamed one also by its former slug.

    Raises:
        UserError: with the nearest names; for a retired rule, with the reason and what proves the same.
    """
    retired_rule = retired.lookup(name)
    if retired_rule is not None:
        raise UserError(retired_rule.text, hint=f"xpl explain {retired_rule.code}")
    names = {key: entry for entry in entries() for key in (entry.code, entry.slug)}
    key = retired.current(name)
    key = key.upper() if key.upper() in names else key.lower()
    if key in names:
        return names[key].load()
    raise no_such(f"there is no rule {name!r}", name, names, listing="xpl rules")


def select(names: tuple[str, ...], ignore: tuple[str, ...], gates: tuple[Gate, ...]) -> tuple[RuleEntry, ...]:
    """Return the rules of some gates that a selection leaves, not imported, in order of code.

    Args:
        names: codes, code prefixes, slugs and `advice` to run; empty for all but advice.
        ignore: the same, to leave out.
        gates: the gates.

    Raises:
        UserError: if a name stands for no rule; one that is retired may still be left out.
    """
    left_out = [name for name in ignore if retired.lookup(name) is None]
    for name in (*names, *left_out):
        if not any(_matches(entry, name) for entry in entries()):
            find(name)
    return tuple(
        entry
        for entry in entries()
        if set(entry.gates) & set(gates)
        and (any(_matches(entry, name) for name in names) if names else not entry.is_advice)
        and not any(_matches(entry, name) for name in ignore)
    )


def lookup(name: str) -> RuleEntry | None:
    """Return what stands for a rule of this code or slug, None if there is none."""
    return next((item for item in entries() if retired.current(name) in {item.code, item.slug}), None)


def prerequisites(item: Rule, chain: tuple[str, ...] = ()) -> tuple[RuleEntry, ...]:
    """Return the rules that a rule comes after.

    Raises:
        RegistryError: if it names a rule that is not there or runs in another gate, or if it comes after itself.
    """
    others = []
    for slug in item.after:
        if slug in {*chain, item.slug}:
            raise RegistryError(f"rules wait for each other: {' after '.join((*chain, item.slug, slug))}")
        other = lookup(slug)
        if other is None or not other.runs_in(item.gate):
            raise RegistryError(f"{item.slug} comes after {slug!r}, which is no rule of the {item.gate} gate")
        prerequisites(other.load(), (*chain, item.slug))
        others.append(other)
    return tuple(others)


def _matches(entry: RuleEntry, name: str) -> bool:
    if name == ADVICE:
        return entry.is_advice
    name = retired.current(name)
    letters, prefix = entry.code.rstrip(string.digits), name.upper()
    return entry.slug == name or (prefix.startswith(letters) and entry.code.startswith(prefix))


def _read_code(path: Path) -> str:
    """Return the code with which the docstring of a rule's file begins."""
    with path.open(encoding="utf-8") as stream:
        return stream.readline().removeprefix('"""').partition(":")[0]


def _load_rule(path: Path) -> Rule:
    module: Any = content.load_module(path)
    declared = [value.xpl_rule for value in vars(module).values() if hasattr(value, "xpl_rule")]
    if len(declared) != 1:
        message = f"{path} must declare exactly one rule, found {len(declared)}"
        raise RuntimeError(message)
    result: Rule = declared[0]
    return result
