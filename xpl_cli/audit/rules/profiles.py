"""What an audit serves: the real model, a shadow of it, or one whose missing modules are stubbed; and why."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from xpl_cli.audit.rules.model import NotRun, Profile
from xpl_cli.serving.stand_in import StandIn

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl_cli.audit.rules.options import Options
    from xpl_cli.serving.launch import ServerStartError

_MODULE, _ENVIRONMENT, _STUB = "module", "environment", "stub"
_SHADOWLESS = frozenset(("shadow", "whole"))
_SENTENCES = {
    _MODULE: "the module {} is not installed here",
    "library": "the library {} is not installed here",
    "device": "there is not {} here",
    "checkpoint": "the checkpoint is not here: {}",
}


class Lacking(NotRun):
    """The machine has not what an answer would take.

    Attributes:
        kind: what that is; a kind of `xpl.worker.lacking`.
    """

    def __init__(self, lacks: Mapping[str, str]) -> None:
        super().__init__(sentence(lacks))
        self.kind = lacks["kind"]

    @property
    def is_stub(self) -> bool:
        """Whether the adapter came as far as to a stub."""
        return self.kind == _STUB


@dataclass(frozen=True)
class Choice:
    """What a gate serves.

    Attributes:
        name: the profile.
        stand_in: what is not real.
        reason: why not everything is; None if it is, or if no more was asked for.
        env: environment of the adapter in place of the one that its manifest names, as for `xpl serve --env`.
        stubbed: modules that were stubbed.
    """

    name: Profile = Profile.FULL
    stand_in: StandIn = field(default_factory=StandIn)
    reason: str | None = None
    env: str | None = None
    stubbed: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """What a reader of the report has to know; empty where everything is real."""
        what = []
        if self.stand_in.shadow:
            what.append("shadow mode: the model was not loaded, and rules that only the model can break do not apply")
        if self.stubbed:
            what.append(f"stubbed: {', '.join(self.stubbed)}")
        return "; ".join(what) + (f" ({self.reason})" if what and self.reason else "")

    @property
    def is_made_of_stubs(self) -> bool:
        """Whether a model was loaded, but not out of real modules only."""
        return bool(self.stubbed) and not self.stand_in.shadow

    @property
    def mark(self) -> str:
        """The end of a finish line; empty where everything is real."""
        shadow = f" profile={self.name}" if self.stand_in.shadow else ""
        return shadow + (f" stubbed={','.join(self.stubbed)}" if self.stubbed else "")

    @classmethod
    def first(cls, options: Options) -> Choice:
        """Return what is tried first."""
        if options.profile is not Profile.SHADOW:
            return cls()
        own = None if options.python or options.env else "none"
        return cls(Profile.SHADOW, StandIn(shadow=True, stub_missing=options.stub_missing), options.profile_reason, own)

    def after(self, problem: ServerStartError, options: Options) -> Choice | None:
        """Return what is tried when this could not be served, None if that is to be reported.

        Without a wish, a shadow of the model is the next best. Stubs are for adapters that have none, and for modules
        that an adapter imports before it is asked to load.
        """
        if problem.lacks is None:
            return None
        kind, why = problem.lacks["kind"], sentence(problem.lacks)
        is_free = options.profile is None
        if self.stand_in.shadow:
            stubs_help = is_free and options.stub_missing and kind in _SHADOWLESS
            return replace(self, name=Profile.FULL, stand_in=StandIn(stub_missing=True)) if stubs_help else None
        if self.stand_in.stub_missing or (kind == _ENVIRONMENT and (options.python or options.env)):
            return None
        if is_free:
            own = "none" if kind == _ENVIRONMENT else None
            return Choice(Profile.SHADOW, StandIn(shadow=True, stub_missing=options.stub_missing), why, own)
        return (
            Choice(stand_in=StandIn(stub_missing=True), reason=why)
            if options.stub_missing and kind == _MODULE
            else None
        )

    def told(self, problem: ServerStartError) -> str:
        """Return why this could not be served, and what may help."""
        if problem.lacks is None:
            return f"the server did not start: {problem}"
        why = sentence(problem.lacks)
        before = f"{self.reason}; in shadow mode: " if self.reason and self.name is Profile.SHADOW else ""
        return f"{before}{why}{self._advice(problem.lacks['kind'])}"

    def _advice(self, kind: str) -> str:
        if self.stand_in.stub_missing:
            return ""
        if self.name is Profile.FULL:
            return "; --shadow audits without the model"
        if kind == _MODULE:
            return "; import it in load, or have it stubbed with --stub-missing"
        return "; what needs no missing module can be tried with --stub-missing" if kind == "whole" else ""


def sentence(lacks: Mapping[str, str]) -> str:
    """Return what a machine lacks in words."""
    return _SENTENCES.get(lacks["kind"], "{}").format(lacks["name"])
