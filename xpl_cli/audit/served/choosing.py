"""How an audit comes to what it serves: the real model first, and what is tried where this machine lacks something."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from xpl_cli.audit.rules.model import NotRun
from xpl_cli.audit.rules.profiles import Choice, Profile
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
    "env_cfg": "the benchmark's env_cfg is not here: {}",
    "upstream": "the code that the adapter wraps is not here: {}",
    "file": "a file outside of the adapter is not here: {}",
    "server": "the server that the adapter asks cannot be reached: {}",
    "setting": "deploy.yml has no {}, which the adapter's script sets",
}
_HELP = {
    _MODULE: "",
    "checkpoint": "fetch it, or name it with --set ckpt_name=...",
    "env_cfg": "audit it beside its benchmark, or name a robot of the standard with --set env_cfg_type=NAME",
    "upstream": "run the adapter's install.sh",
    "file": "bring it here, or name another with --set",
    "server": "start it first",
    "setting": "give it with --set",
}
"""What to do where the real thing is wanted."""


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


def first(options: Options) -> Choice:
    """Return what is tried first."""
    if options.profile is not Profile.SHADOW:
        return Choice()
    own = None if options.python or options.env else "none"
    return Choice(Profile.SHADOW, StandIn(shadow=True, stub_missing=options.stub_missing), options.profile_reason, own)


def after(choice: Choice, problem: ServerStartError, options: Options) -> Choice | None:
    """Return what is tried when this could not be served, None if that is to be reported.

    Without a wish, a shadow of the model is the next best. Stubs are for adapters that have none, and for modules
    that an adapter imports before it is asked to load.
    """
    if problem.lacks is None:
        return None
    kind, why = problem.lacks["kind"], sentence(problem.lacks)
    is_free = options.profile is None
    if choice.stand_in.shadow:
        stubs_help = is_free and options.stub_missing and kind in _SHADOWLESS
        return replace(choice, name=Profile.FULL, stand_in=StandIn(stub_missing=True)) if stubs_help else None
    if choice.stand_in.stub_missing or (kind == _ENVIRONMENT and (options.python or options.env)):
        return None
    if is_free:
        own = "none" if kind == _ENVIRONMENT else None
        return Choice(Profile.SHADOW, StandIn(shadow=True, stub_missing=options.stub_missing), why, own)
    return Choice(stand_in=StandIn(stub_missing=True), reason=why) if options.stub_missing and kind == _MODULE else None


def told(choice: Choice, problem: ServerStartError) -> str:
    """Return why this could not be served, and what may help."""
    if problem.lacks is None:
        return f"the server did not start: {problem}"
    why = sentence(problem.lacks)
    before = f"{choice.reason}; in shadow mode: " if choice.reason and choice.name is Profile.SHADOW else ""
    return f"{before}{why}{_advice(choice, problem.lacks['kind'])}"


def _advice(choice: Choice, kind: str) -> str:
    if choice.stand_in.stub_missing:
        return ""
    if choice.name is Profile.FULL:
        told = _HELP.get(kind)
        return f"; {told}; --shadow audits without the model" if told else "; --shadow audits without the model"
    if kind == _MODULE:
        return "; import it in load, or have it stubbed with --stub-missing"
    return "; what needs no missing module can be tried with --stub-missing" if kind == "whole" else ""


def sentence(lacks: Mapping[str, str]) -> str:
    """Return what a machine lacks in words."""
    return _SENTENCES.get(lacks["kind"], "{}").format(lacks["name"])
