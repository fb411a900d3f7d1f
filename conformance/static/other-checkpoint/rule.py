"""XPL126: A missing checkpoint is an error."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.candidates import nested_listings, substitutes
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import LOADING, ModelClass
from xpl_cli.audit.static.scripted_candidates import scripted_substitutes
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import (
    assigned,
    called,
    constant,
    enclosing,
    key_read,
    last,
    names,
    parameters,
    targets,
)
from xpl_cli.audit.static.unread import is_unread

_LISTS: Final = frozenset(("listdir", "iterdir", "glob", "rglob", "iglob", "scandir"))
_EXISTS: Final = frozenset(("is_file", "exists", "isfile", "is_dir", "isdir"))
_NAMED: Final = re.compile(r"ckpt|checkpoint|name|run|step|num", re.IGNORECASE)
_STEP: Final = re.compile(
    r"(?!.*(?:infer|denois|diffus|sampl|action|_steps))(?:.*step|.*number|.*epoch|(?:.*_)?num|.*iter(?:ation|$|_))",
    re.IGNORECASE,
)
"""Names of the step of training that is wanted, and not of how many an inference takes."""
_IS: Final = (ast.Is, ast.Eq, ast.In)
_IS_NOT: Final = (ast.IsNot, ast.NotEq, ast.NotIn)


@rule(code="XPL126", requirement="XPL-CKP-1")
def other_checkpoint(source: Source) -> Iterator[Finding]:
    """A requested checkpoint that does not exist is replaced by another one.

    ## What it does
    Looks, in what `load` reaches, for directory listings that are searched by a prefix (`run-1` also matches
    `run-1-other` and `run-10`), or through all folders below; for functions that get the requested step and, without an
    error if it is missing, select an entry by position, such as the last; for files that are taken from any
    neighbouring run that has one; for lists of places, in code and in scripts, of which the first that exists is taken,
    although it does not depend on what was requested; and for a `ckpt_name` that no code reads.

    ## Why it matters
    The results of an evaluation are then those of other weights than its label says. It happens, unnoticed, if a
    training run was not copied completely.

    ## Example
    `max(folder.glob(f"step_{step}*"))`: step 5 loads step 50000.

    ## Use instead
    `xpl.checkpoint.resolve(config, self.policy_dir)`, which raises an error and lists the existing checkpoints.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    yield from _substituted(source, adapter)
    if not adapter.is_sdk and is_unread(adapter, sdk.Deploy.CKPT_NAME):
        yield Finding(
            f"no code reads {sdk.Deploy.CKPT_NAME}: whichever checkpoint is requested, the same one is evaluated",
            **source.start(adapter.file, adapter.node),
            expected=f"the checkpoint that {sdk.Deploy.CKPT_NAME} names, or an error",
            got="a configuration of which other keys are read",
            fix=Fix("advice", "xpl.checkpoint.resolve(config, policy_dir) finds it by the order of the standard"),
        )
    for function in adapter.reach(*LOADING):
        listed = [node for node in function.of(ast.Call) if last(called(node)) in _LISTS]
        for node, prefix in (*_prefixes(function, listed), *_patterns(listed)):
            yield Finding(
                f"a checkpoint {prefix!r} that does not exist is replaced by one whose name starts with it",
                **source.at(function.file, node),
                expected="an error that lists the existing checkpoints",
                got=ast.unparse(node),
                fix=Fix("advice", "compare whole names, or use xpl.checkpoint.resolve"),
            )
        steps = _given(function)
        for choice in _unrefused(adapter, function, steps):
            yield Finding(
                f"if {min(steps)} names a checkpoint that does not exist, the search continues and loads another one",
                **source.start(function.file, choice),
                expected="an error after the checkpoint was not found",
                got=ast.unparse(choice).split("\n")[0],
                fix=Fix("advice", "raise an error if the checkpoint was not found"),
            )
        for loop in _neighbours(function):
            yield Finding(
                "if the checkpoint lacks a file, that of a neighbouring run is used: the first in the folder",
                **source.start(function.file, loop),
                expected="an error that names the missing file",
                got=ast.unparse(loop).split("\n")[0],
                fix=Fix("advice", "look in the checkpoint's own folder only, and raise an error"),
            )


def _substituted(source: Source, adapter: ModelClass) -> Iterator[Finding]:
    """Yield files that are taken although they are not what was requested."""
    expected = "an error that names the missing checkpoint"
    fix = Fix("advice", "look for what was requested only, and raise an error if it is missing")
    for one in substitutes(adapter):
        yield Finding(
            f"if {one.requested} does not exist, {ast.unparse(one.node)} is loaded in its place",
            **source.at(one.function.file, one.node),
            expected=expected,
            got=ast.unparse(one.node),
            fix=fix,
        )
    for function, call, pattern in nested_listings(adapter):
        yield Finding(
            f"{pattern} is searched through all folders below: the checkpoint of another run, or a copy, may be loaded",
            **source.at(function.file, call),
            expected="the files directly in the folder of the checkpoint",
            got=ast.unparse(call),
            fix=fix,
        )
    for found in scripted_substitutes(source):
        yield Finding(
            f"of {found.requested} and {found.other} the first that exists is used, which may not be the requested one",
            path=found.file,
            line=found.line,
            column=1,
            expected=expected,
            got=found.other,
            fix=fix,
        )


def _prefixes(function: Function, listed: list[ast.Call]) -> Iterator[tuple[ast.Call, str]]:
    """Yield `entry.startswith(prefix)` over a listing, where the prefix is made of a value and not constant."""
    made = assigned(function.nodes)
    for node in function.of(ast.Call) if listed else ():
        if last(called(node)) != "startswith" or len(node.args) != 1:
            continue
        prefix = node.args[0]
        value = made.get(prefix.id, prefix) if isinstance(prefix, ast.Name) else prefix
        if isinstance(value, ast.Name) and value.id in parameters(function.node) and _NAMED.search(value.id):
            yield node, value.id
        elif isinstance(value, ast.JoinedStr) and value.values and isinstance(value.values[0], ast.FormattedValue):
            yield node, ast.unparse(value.values[0].value)


def _patterns(listed: list[ast.Call]) -> Iterator[tuple[ast.Call, str]]:
    """Yield `glob(f"...{value}*")`: a wildcard right behind a value, or behind a dash that names contain too."""
    for node in listed:
        for pattern in (entry for entry in ast.walk(node) if isinstance(entry, ast.JoinedStr)):
            for value, after in zip(pattern.values, pattern.values[1:], strict=False):
                if isinstance(value, ast.FormattedValue) and isinstance(after, ast.Constant):
                    value_text = ast.unparse(value.value)
                    is_step = _STEP.match(value_text) is not None
                    if re.match(r"\*" if is_step else r"[-_]?\*", str(after.value)):
                        yield node, value_text


def _given(function: Function) -> set[str]:
    """Return the names that hold the step that was requested: read from the configuration, or an optional parameter."""
    arguments = function.node.args
    every = [*arguments.posonlyargs, *arguments.args]
    defaults = dict(zip(reversed(every), reversed(arguments.defaults), strict=False))
    steps = {
        argument.arg
        for argument in every
        if constant(defaults.get(argument)) is None
        or (argument.annotation is not None and "None" in ast.unparse(argument.annotation))
        if _STEP.match(argument.arg)
    }
    for name, value in _assignments(function):
        keys = {read.key for child in ast.walk(value) if (read := key_read(child)) is not None}
        handed = value.args if isinstance(value, ast.Call) else [value]
        if any(map(_STEP.match, keys)) or any(isinstance(part, ast.Name) and part.id in steps for part in handed):
            steps.add(name)
    return steps


def _unrefused(adapter: ModelClass, function: Function, steps: set[str]) -> Iterator[ast.stmt]:
    """Yield the first choice of an entry by its place, or of any, that a step which is missing leads to as well."""
    if not any(names(node) & steps for node in function.of(ast.Compare, ast.Lambda)):
        return
    sought = set(steps)
    for name, value in _assignments(function):
        if names(value) & sought:
            sought.add(name)
    entries = _entries(adapter, function) - sought
    for node in function.of(ast.Return, ast.Assign, ast.For):
        is_choice = False
        if isinstance(node, ast.For):
            leaves = any(isinstance(child, (ast.Return, ast.Break)) for child in ast.walk(node))
            is_choice = leaves and bool(names(node.iter) & entries) and not names(node) & sought
        elif isinstance(node, (ast.Return, ast.Assign)):
            picked = [child for child in ast.walk(node.value) if _picks(child)] if node.value is not None else []
            is_choice = any(names(child) & entries or _listed(child, sought) for child in picked)
        if is_choice and not _is_refused(node, function, steps, sought):
            yield node
            return


def _entries(adapter: ModelClass, function: Function) -> set[str]:
    """Return the names that hold entries of a folder, listed here or by a helper, sifted or not."""
    entry_names: set[str] = set()
    added = [
        (call.func.value.id, call.args[0])
        for call in function.of(ast.Call)
        if isinstance(call.func, ast.Attribute) and isinstance(call.func.value, ast.Name)
        if call.func.attr in {"append", "extend"} and call.args
    ]
    for name, value in (*added, *_assignments(function)):
        for child in ast.walk(value):
            helper = adapter.callee(function, child) if isinstance(child, ast.Call) else None
            if _listed(helper.node if helper is not None else child, set()) or names(child) & entry_names:
                entry_names.add(name)
    return entry_names


def _assignments(function: Function) -> Iterator[tuple[str, ast.expr]]:
    for node in function.of(ast.Assign):
        for target in targets(node):
            if isinstance(target, ast.Name):
                yield target.id, node.value


def _listed(node: ast.AST, sought: set[str]) -> bool:
    """Tell whether a folder is listed below a node, and not by the step that is sought."""
    return any(last(called(child)) in _LISTS and not names(child) & sought for child in ast.walk(node))


def _picks(node: ast.AST) -> bool:
    """Tell whether one of many is taken by its place: the greatest, the first, the last."""
    if isinstance(node, ast.Subscript):
        return constant(node.slice) in {0, -1}
    return last(called(node)) in {"max", "min"}


def _is_refused(node: ast.stmt, function: Function, steps: set[str], sought: set[str]) -> bool:
    """Tell whether a statement runs only where no step was given, or after an error for one that is missing."""
    inner: ast.AST = node
    for outer in enclosing(node, function.up):
        if isinstance(outer, ast.If) and (inner in outer.body) is _denies(outer.test, steps):
            return True
        for block in (getattr(outer, name, None) for name in ("body", "orelse")):
            for before in block[: block.index(inner)] if isinstance(block, list) and inner in block else ():
                raises = any(isinstance(child, ast.Raise) for child in ast.walk(before))
                if isinstance(before, ast.If) and names(before.test) & sought and raises:
                    return True
        inner = outer
    return False


def _denies(test: ast.expr, steps: set[str]) -> bool | None:
    """Tell whether a test holds where no step was given (true), where one was (false), or asks something else."""
    if isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not):
        inner = _denies(test.operand, steps)
        return None if inner is None else not inner
    if isinstance(test, ast.Name):
        return False if test.id in steps else None
    if isinstance(test, ast.Compare) and names(test.left) & steps and not names(test.comparators[0]):
        return True if isinstance(test.ops[0], _IS) else False if isinstance(test.ops[0], _IS_NOT) else None
    return None


def _neighbours(function: Function) -> Iterator[ast.For]:
    """Yield loops over the folder above the one that was requested, which take a file of the first run that has one."""
    above = {name for name, value in assigned(function.nodes).items() if _leads_up(value)}
    for loop in function.of(ast.For):
        listing = next((call for call in ast.walk(loop.iter) if last(called(call)) in _LISTS), None)
        if listing is None or not (names(listing) & above or _leads_up(listing)):
            continue
        inside = list(ast.walk(loop))
        entry = {target.id for target in targets(loop) if isinstance(target, ast.Name)}
        is_taken = any(isinstance(node, (ast.Return, ast.Break)) for node in inside)
        is_any = any(last(called(node)) in _EXISTS for node in inside)
        if is_taken and is_any and not any(isinstance(node, ast.Compare) and names(node) & entry for node in inside):
            yield loop


def _leads_up(node: ast.AST) -> bool:
    """Tell whether a path is that of a folder above another one, and not above this file."""
    ups = {child.attr for child in ast.walk(node) if isinstance(child, ast.Attribute)}
    return bool(ups & {"parent", "parents", "dirname"}) and "__file__" not in names(node)
