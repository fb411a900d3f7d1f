"""The steps of a package on its way to green, each with its state: read from files, nothing is run."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl_cli import __version__
from xpl_cli.audit.engine.circumstances import places
from xpl_cli.audit.rules.gates import GATES, Gate
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.basics.errors import UserError
from xpl_cli.basics.strangers import command
from xpl_cli.packages import package

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from xpl.manifest import PythonEnvironment
    from xpl_cli.agents.status.memory import Found, Remembered
    from xpl_cli.audit.static.source import Source
    from xpl_cli.packages.package import Package
    from xpl_cli.packages.targets import Target

PLACEHOLDERS: Final = "placeholders"
_MOST_PLACES: Final = 5
_MOST_EXPLAINED: Final = 3
_NEEDS_NOTHING: Final = ("current", "given")


class State(StrEnum):
    """How far a step is.

    `partial` is a gate that passed with a stand-in for the model; `stale` is what was proved of other files than are
    there now; `not_run` is a gate that could not run, and never counts as a pass.
    """

    DONE = "done"
    OPEN = "open"
    FAILED = "failed"
    STALE = "stale"
    PARTIAL = "partial"
    NOT_RUN = "not_run"
    NOT_APPLICABLE = "not_applicable"


@dataclass(frozen=True)
class Step:
    """One step.

    Attributes:
        name: the step.
        state: how far it is.
        detail: one line: what is there, or what is missing.
        commands: exact commands that bring it on; empty where a person or agent has to edit.
        when: when a gate ran, UTC.
        finish: the finish line of a gate.
        found: what a gate found when it last ran, on the files that are there now.
        omitted: how many rules that found something are left out of `found`.
    """

    name: str
    state: State
    detail: str
    commands: tuple[str, ...] = ()
    when: str | None = None
    finish: str | None = None
    found: tuple[Found, ...] = ()
    omitted: int = 0

    @property
    def is_settled(self) -> bool:
        """Whether nothing is left to do."""
        return self.state in (State.DONE, State.NOT_APPLICABLE)


def steps(target: Target, source: Source, remembered: Mapping[str, Remembered]) -> Iterator[Step]:
    """Yield the steps of a package in the order in which they are worth taking.

    Args:
        target: the package.
        source: its files.
        remembered: what the last audits found, by gate.
    """
    shown = command((target.shown,))
    try:
        loaded, declared = _read(target)
    except UserError as error:
        yield _broken(error, shown)
    else:
        yield _manifest(target, source, shown)
        yield _placeholders(source)
        yield _environment(target.path, declared, shown)
        if loaded is not None:
            yield _checkpoint(loaded, shown)
    for gate in GATES[target.kind]:
        now = source.whole() if gate is Gate.STATIC else source.record()
        yield _gate(gate, remembered.get(gate.value), now, shown)


def _read(target: Target) -> tuple[Package | None, PythonEnvironment]:
    """Return what the manifests of a package say; there is no `Package` of an environment."""
    if target.kind == package.ENV:
        from xpl_cli.packages import environments

        return None, environments.manifest(target.path).environment
    loaded = package.load(target.path)
    return loaded, loaded.manifest.environment


def _broken(error: UserError, shown: str) -> Step:
    from xpl_cli.packages.manifests import ManifestError

    text = " ".join(str(error).split())
    if isinstance(error, ManifestError):
        return Step("manifest", State.FAILED, text, (f"xpl spec validate {command((str(error.path),))}",))
    return Step("manifest", State.FAILED, text, (f"xpl audit {shown} --gate {Gate.STATIC}",))


def _manifest(target: Target, source: Source, shown: str) -> Step:
    if target.kind == package.POLICY and source.is_ecosystem:
        detail = f"there is no {sdk.File.POLICY_YML}"
        return Step("manifest", State.OPEN, detail, (f"xpl adopt {shown} --dry-run", f"xpl adopt {shown}"))
    return Step("manifest", State.DONE, "is what the standard asks for")


def _placeholders(source: Source) -> Step:
    found = list(places(source))
    if not found:
        return Step(PLACEHOLDERS, State.DONE, "nothing is left to fill in")
    more = f" and {len(found) - _MOST_PLACES} more" if len(found) > _MOST_PLACES else ""
    return Step(PLACEHOLDERS, State.OPEN, f"fill in {', '.join(found[:_MOST_PLACES])}{more}")


def _environment(folder: Path, declared: PythonEnvironment, shown: str) -> Step:
    from xpl_cli.lifecycle import scripts

    try:
        condition = scripts.condition(folder, declared)
    except UserError as error:
        return Step("environment", State.FAILED, str(error))
    told = {"given": "an interpreter that exists already", "current": "as declared"}
    if condition in _NEEDS_NOTHING:
        return Step("environment", State.DONE, told[condition])
    return Step("environment", State.OPEN, f"{condition}: not as the manifest declares", (f"xpl install {shown}",))


def _checkpoint(loaded: Package, shown: str) -> Step:
    from xpl_cli.lifecycle.checkpoints import fetch, specification

    if not loaded.manifest.checkpoints:
        return Step("checkpoint", State.NOT_APPLICABLE, f"{sdk.File.POLICY_YML} names none")
    try:
        (wanted,) = specification.choose(loaded, None)
        path = fetch.located(wanted)
    except UserError as error:
        return Step("checkpoint", State.FAILED, str(error))
    if path is not None:
        return Step("checkpoint", State.DONE, f"{wanted.name}: {path}")
    next_step = f"xpl checkpoint fetch {shown} {command((wanted.name,))}"
    return Step("checkpoint", State.OPEN, f"{wanted.name} was not fetched", (next_step,))


def _gate(gate: Gate, last: Remembered | None, now: str, shown: str) -> Step:
    """Return a gate as its last run left it, as far as that was about the files that are there now."""
    name = gate.value
    if last is None:
        return Step(name, State.OPEN, "not audited yet", (f"xpl audit {shown}",))
    again = " ".join(["xpl", "audit", shown, command(last.options)]).rstrip()
    if last.source != now or last.tool != __version__:
        why = "files changed since" if last.source != now else f"by xpl {last.tool}, and this is {__version__}"
        return Step(name, State.STALE, f"{_word(last.outcome)} once: {why}", (again,), last.when)
    if last.outcome == Outcome.PASS and last.stood_in:
        detail = f"passed, but {last.stood_in}"
        real = f"xpl audit {shown} --profile {Profile.FULL}"
        return Step(name, State.PARTIAL, detail, (real,), last.when, last.finish, last.found, last.omitted)
    state = _STATES.get(last.outcome, State.FAILED)
    reasons = [found for found in last.found if found.outcome == last.outcome]
    detail = _word(last.outcome) if not reasons else f"{_word(last.outcome)}: {reasons[0].code} {reasons[0].message}"
    explained = tuple(f"xpl explain {found.code}" for found in reasons[:_MOST_EXPLAINED])
    commands = () if state in (State.DONE, State.NOT_APPLICABLE) else (*explained, again)
    return Step(name, state, detail, commands, last.when, last.finish, last.found, last.omitted)


def _word(outcome: str) -> str:
    return _WORDS.get(outcome, outcome)


_STATES: Final = {
    Outcome.PASS.value: State.DONE,
    Outcome.NOT_APPLICABLE.value: State.NOT_APPLICABLE,
    Outcome.NOT_RUN.value: State.NOT_RUN,
}
_WORDS: Final = {
    Outcome.PASS.value: "passed",
    Outcome.FAIL.value: "failed",
    Outcome.ERROR.value: "a rule crashed",
    Outcome.NOT_RUN.value: "could not run",
    Outcome.NOT_APPLICABLE.value: "nothing to prove",
}
