"""What the model answers: control, chunk, history, rate, gripper; read from the class and from deploy.yml."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl_cli.adopt.facts import Confidence, Evidence, Fact, Finding, Question, certain, likely
from xpl_cli.adopt.values import UNKNOWN
from xpl_cli.audit.static.adapter import ACTING, LOADING, OBSERVING
from xpl_cli.audit.static.manifests import key_line
from xpl_cli.audit.static.syntax import always_raises, called, dotted, key_read, last, names, self_attribute
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from xpl_cli.adopt.values import Values
    from xpl_cli.audit.static.function import Function

_CHUNK: Final = re.compile(r"chunk|horizon|replan|n_action|action_steps|num_actions", re.IGNORECASE)
_HISTORY: Final = re.compile(r"history|n_obs|obs_steps|window", re.IGNORECASE)
_RATE: Final = re.compile(r"(ctrl|control)_?(freq|frequency|rate|hz)\w*", re.IGNORECASE)
_ENSEMBLING: Final = re.compile(r"temporal_agg|ensembl", re.IGNORECASE)


def temporal(values: Values) -> Iterator[Finding]:
    """Yield how past and future enter."""
    chunk = _chunk(values)
    history = _history(values)
    yield chunk
    if history is not None:
        yield history
    kinds = tuple(spec.schema("policy")["properties"]["temporal"]["properties"]["kind"]["enum"])
    single, several, past, _ = kinds
    meaning = "how past and future enter"
    if history is not None:
        yield Fact("temporal.kind", past, history.confidence, history.evidence)
    elif isinstance(chunk, Fact):
        kind = several if chunk.value > 1 else single
        yield likely("temporal.kind", kind, Evidence("", None, "the chunk below, and no history that the code shows"))
    else:
        yield Question("temporal.kind", meaning, kinds, chunk.seen)
    seen = _settings_like(values, _ENSEMBLING)
    on = [entry for entry, value in seen if value not in (False, None, 0)]
    if on:
        yield Question("temporal.ensembling", "decay of the temporal ensembling", seen=tuple(on))


def _chunk(values: Values) -> Fact | Question:
    """Return the steps of one answer: where the model's methods cut or count what the network returned."""
    found: dict[int, tuple[Evidence, ...]] = {}
    for function in values.adapter.reach(*ACTING):
        for node in function.of(ast.Subscript, ast.Call):
            limit = _limit(node)
            value = values.of(limit, function) if limit is not None else UNKNOWN
            if type(value) is not int or value < 1 or not any(map(_CHUNK.search, values.keys)):
                continue
            if not any(map(_HISTORY.search, values.keys)):
                what = f"{ast.unparse(node)[:60]} takes as many"
                found.setdefault(value, (*values.trail, Evidence(function.file, node.lineno, what)))
    if not found:
        alike = (*_settings_like(values, _CHUNK), *_settings_like(values, _ENSEMBLING))
        seen = tuple(entry for entry, _ in alike)
        return Question("temporal.chunk", "action steps returned by one call", seen=seen)
    shortest = min(found)
    return likely("temporal.chunk", shortest, *found[shortest])


def _limit(node: ast.expr) -> ast.expr | None:
    """Return what bounds a sequence of actions: `actions[:n]`, `range(n)`."""
    if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Load):
        cut = node.slice.elts[0] if isinstance(node.slice, ast.Tuple) and node.slice.elts else node.slice
        return cut.upper if isinstance(cut, ast.Slice) and cut.lower is None else None
    return node.args[0] if isinstance(node, ast.Call) and called(node) == "range" and len(node.args) == 1 else None


def _history(values: Values) -> Fact | None:
    """Return the observations that are kept: the length of a deque, or how many last frames are taken."""
    for function in values.adapter.reach(*OBSERVING, *ACTING, *LOADING):
        for node in function.of(ast.Subscript, ast.Call):
            length = _kept(node)
            value = values.of(length, function) if length is not None else UNKNOWN
            if type(value) is int and value > 1 and any(map(_HISTORY.search, values.keys)):
                what = f"{ast.unparse(node)[:60]} keeps as many"
                return likely("temporal.history", value, *values.trail, Evidence(function.file, node.lineno, what))
    return None


def _kept(node: ast.expr) -> ast.expr | None:
    """Return how many of the last entries are kept: `frames[-n:]`, `deque(maxlen=n)`."""
    if isinstance(node, ast.Call):
        given = [keyword.value for keyword in node.keywords if keyword.arg == "maxlen"] or node.args[1:2]
        return given[0] if given and last(called(node)) == "deque" else None
    cut = node.slice if isinstance(node, ast.Subscript) else None
    lower = cut.lower if isinstance(cut, ast.Slice) and cut.upper is None else None
    return lower.operand if isinstance(lower, ast.UnaryOp) and isinstance(lower.op, ast.USub) else None


def _settings_like(values: Values, pattern: re.Pattern[str]) -> list[tuple[Evidence, object]]:
    """Return entries of deploy.yml whose keys look like what was not found."""
    name = sdk.File.DEPLOY_YML
    found: list[tuple[Evidence, object]] = []
    for key, value in values.source.deploy.items():
        if pattern.search(str(key)) and isinstance(value, (int, float)):
            found.append((Evidence(name, key_line(values.source, name, key), f"{key}: {str(value).lower()}"), value))
    return found


def rate(values: Values) -> Iterator[Finding]:
    """Yield the rate of the actions, where a setting that the code reads names it."""
    for setting in values.adapter.settings:
        value = values.setting(setting.read, setting.function) if _RATE.fullmatch(setting.read.key) else None
        if isinstance(value, (int, float)) and not isinstance(value, bool) and value > 0:
            values.trail, trail = [], tuple(values.trail[-1:])
            yield likely("control_frequency", value, *trail)
            return
    meaning = "rate at which the action steps are meant to be executed, Hz; null: not told"
    yield Question("control_frequency", meaning, seen=tuple(entry for entry, _ in _settings_like(values, _RATE)))


# -- control -----------------------------------------------------------------------------------------------------------


def action_types(values: Values, told: Evidence | None) -> Iterator[Finding]:
    """Yield the kinds of control.

    Args:
        values: the adapter.
        told: where the README's commands name a kind, which `what` holds.
    """
    known = tuple(spec.data("conventions")["action"]["types"])
    refused = list(_refusals(values, known))
    if refused:
        allowed, evidence = refused[0]
        yield certain("action_types", list(allowed), evidence)
        return
    handled: dict[str, Evidence] = dict(_compared(values, known))
    name = sdk.File.DEPLOY_YML
    given = values.source.deploy.get(sdk.Deploy.ACTION_TYPE)
    if isinstance(given, str) and given in known:
        line = key_line(values.source, name, sdk.Deploy.ACTION_TYPE)
        handled.setdefault(given, Evidence(name, line, f"{sdk.Deploy.ACTION_TYPE}: {given}"))
    if told is not None and (kind := next((kind for kind in known if kind in told.what.split()), None)):
        handled.setdefault(kind, told)
    if handled:
        ordered = [kind for kind in known if kind in handled]
        yield likely("action_types", ordered, *(handled[kind] for kind in ordered))
    else:
        yield Question("action_types", "what the actions are", known)


def _refusals(values: Values, known: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Evidence]]:
    """Yield the kinds that are left where every other one raises."""
    for function in values.adapter.reach(*values.adapter.methods):
        for node in function.of(ast.If):
            test = node.test
            if not isinstance(test, ast.Compare) or len(test.ops) != 1 or not always_raises(node.body):
                continue
            if isinstance(test.ops[0], (ast.NotEq, ast.NotIn)) and _is_kind(test.left, function):
                given = values.of(test.comparators[0], function)
                wanted = given if isinstance(given, (tuple, frozenset)) else (given,)
                kinds = tuple(kind for kind in known if kind in wanted)
                if (kinds and len(kinds) < len(known)) or set(wanted) == set(known):
                    what = f"refuses {ast.unparse(test)[:60]}"
                    yield kinds, Evidence(function.file, node.lineno, what)


def _compared(values: Values, known: tuple[str, ...]) -> Iterator[tuple[str, Evidence]]:
    """Yield the kinds that the code treats on their own."""
    for function in values.adapter.reach(*values.adapter.methods):
        for node in function.of(ast.Compare):
            if len(node.ops) == 1 and isinstance(node.ops[0], ast.Eq) and _is_kind(node.left, function):
                kind = values.of(node.comparators[0], function)
                if kind in known:
                    yield kind, Evidence(function.file, node.lineno, f"handles {ast.unparse(node)[:60]}")


def _is_kind(node: ast.expr, function: Function) -> bool:
    """Tell whether an expression is the kind of control that was configured."""
    name = sdk.Deploy.ACTION_TYPE
    if isinstance(node, ast.Name):
        return node.id == name and function.name != "_"
    read = key_read(node)
    return self_attribute(node) == name or (read is not None and read.key == name) or last(dotted(node)) == name


def gripper(values: Values) -> Iterator[Finding]:
    """Yield what gripper commands mean: two states where the code compares them with a threshold, else an opening."""
    commands = spec.schema("policy").get("$defs", {}).get("gripper", {}).get("properties", {}).get("command", {})
    if "enum" not in commands:
        return
    opening, two_states = commands["enum"]
    for function in values.adapter.reach(*ACTING):
        for node in function.of(ast.Call):
            if last(called(node)) != "where" or len(node.args) < 3:
                continue
            ends = [end for part in node.args[1:3] if isinstance(end := values.of(part, function), (int, float))]
            if sorted(ends) == [0, 1] and any("grip" in name.lower() for name in names(node)):
                evidence = Evidence(function.file, node.lineno, f"{ast.unparse(node)[:70]}")
                yield likely("gripper.command", two_states, evidence)
                return
    contract = Evidence("", None, "grippers of the ecosystem open to any value between 0 and 1; nothing here rounds it")
    yield Fact("gripper.command", opening, Confidence.ASSUMED, (contract,))
