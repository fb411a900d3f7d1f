"""Choice of what an audit serves: the real model first, and a shadow where this machine lacks something."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl import checkpoint
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.audit.rules.profiles import Profile, ServedProfile
from xpl_cli.serving.launch import MissingRequirement

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from xpl_cli.audit.rules.options import AuditOptions
    from xpl_cli.serving.launch import ServerStartError

_MODULE, _CHECKPOINT, _HUB, _ENVIRONMENT, _WHOLE = "module", "checkpoint", "hub", "environment", "whole"
_SENTENCES = {
    _MODULE: "the module {} is not installed here",
    "library": "the library {} is not installed here",
    "device": "there is not {} here",
    _CHECKPOINT: "the checkpoint is not here: {}",
    _HUB: "a repository of the hub that loading names is not here: {}",
    "env_cfg": "the benchmark's env_cfg is not here: {}",
    "upstream": "the code that the adapter wraps is not here: {}",
    "file": "a file outside of the adapter is not here: {}",
    "server": "the server that the adapter asks cannot be reached: {}",
    "open": "{}",
    "setting": "deploy.yml has no {}, which the adapter's script sets",
}
_REAL = (
    "give it its own libraries (`xpl install`, or their interpreter by --python) and, where deploy.yml names it, a "
    "checkpoint: a tiny one with random weights will do"
)
"""Advice for an adapter that has no shadow."""
_INTERPRETER = "name the interpreter that has its libraries: --python FILE"
_HELP = {
    _MODULE: _INTERPRETER,
    "library": _INTERPRETER,
    _CHECKPOINT: "fetch the checkpoint, or name one with --set ckpt_name=NAME: tiny random weights will do",
    _HUB: "name it in `hub` of policy.yml, and `xpl checkpoint fetch` brings it",
    "env_cfg": "audit it beside its benchmark, or name a robot of the standard with --set env_cfg_type=NAME",
    "upstream": "run the adapter's install.sh",
    "file": "bring it here, or name another with --set",
    "server": "start it first",
    "setting": "give it with --set",
}
"""Advice where the real model is required."""


def first_choice(options: AuditOptions) -> ServedProfile:
    """Return the first choice."""
    if options.profile is not Profile.SHADOW:
        return ServedProfile()
    own = None if options.python or options.env else "none"
    return ServedProfile(Profile.SHADOW, options.profile_reason, own)


def next_choice(choice: ServedProfile, problem: ServerStartError, options: AuditOptions) -> ServedProfile | None:
    """Return the choice after one that could not be served, None if the failure is final.

    Unless the user asks for a profile, a shadow of the model is the next choice.
    """
    if problem.lacks is None or choice.is_shadow or options.profile is not None:
        return None
    is_uninstalled = problem.lacks.kind == _ENVIRONMENT
    if is_uninstalled and (options.python or options.env):
        return None
    env = "none" if is_uninstalled else None
    return ServedProfile(Profile.SHADOW, describe_missing(problem.lacks), env, (problem.lacks.kind,))


def not_served(
    choice: ServedProfile, problem: ServerStartError, config: Mapping[str, object], policy_dir: Path
) -> NotRun:
    """Return why an adapter could not be served, with advice.

    Args:
        choice: the last one.
        problem: why it failed.
        config: the adapter's configuration, which names its checkpoint.
        policy_dir: its folder.
    """
    if problem.lacks is None:
        return NotRun(f"the server did not start: {problem}")
    kind, why = problem.lacks.kind, describe_missing(problem.lacks)
    if not choice.is_shadow:
        helps = _advice((kind,))
        parts = (why, *helps, "--shadow audits one of xpl.Policy without the model")
        return NotRun("; ".join(parts), brief=_brief(why), advice=helps, lacks=(kind,))
    before, lacks = choice.reason or "", choice.lacks
    if kind == _WHOLE:
        missing = _describe_missing_checkpoint(before, config, policy_dir)
        lacks = (*lacks, *((_CHECKPOINT,) if missing else ()))
        return NotRun(
            "; ".join(filter(None, (before, missing, why, _REAL))),
            brief="; ".join(filter(None, (_brief(before), _brief(missing)))) or why,
            advice=_advice(lacks) or (_REAL,),
            lacks=lacks,
        )
    later = "; import it in load" if kind == _MODULE else ""
    reason = f"{before}{'; in shadow mode: ' if before else ''}{why}{later}"
    return NotRun(reason, brief=_brief(why), advice=_advice((kind,)), lacks=(*lacks, kind))


def _advice(lacks: Iterable[str]) -> tuple[str, ...]:
    """Return what to do about kinds of missing things."""
    return tuple(dict.fromkeys(_HELP[kind] for kind in lacks if kind in _HELP))


def _brief(description: str) -> str:
    """Return a description without the paths that were tried and the advice."""
    return description.partition(": tried ")[0].partition("; `xpl ")[0]


def _describe_missing_checkpoint(described: str, config: Mapping[str, object], policy_dir: Path) -> str:
    """Return that the checkpoint is missing, unless the description already says so."""
    try:
        checkpoint.resolve(config, policy_dir)
    except checkpoint.CheckpointError as error:
        description = describe_missing(MissingRequirement(_CHECKPOINT, str(error)))
        return "" if str(error) in described else description
    return ""


def describe_missing(lacks: MissingRequirement) -> str:
    """Return a description of what a machine lacks."""
    return _SENTENCES.get(lacks.kind, "{}").format(lacks.name)
