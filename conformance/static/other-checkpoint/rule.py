"""XPL126: A checkpoint that does not exist is an error."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import LOADING, Adapter
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import (
    assigned,
    called,
    constant,
    enclosing,
    key_read,
    last,
    leaves,
    names,
    parameters,
    targets,
    texts,
)

_LISTS = frozenset(("listdir", "iterdir", "glob", "rglob", "iglob", "scandir"))
_NAMED = re.compile(r"ckpt|checkpoint|name|run|step|num", re.IGNORECASE)
_STEP = re.compile(r"step|(?:^|_)num|number|iter(?:ation|$|_)|epoch", re.IGNORECASE)
_EXISTS = frozenset(("is_file", "exists", "isfile", "is_dir", "isdir"))
_TENS = frozenset((10, 100, 1000))


@rule(code="XPL126", requirement="XPL-CKP-1")
def other_checkpoint(source: Source) -> Iterator[Finding]:
    """A checkpoint that was asked for and does not exist is replaced by another one.

    ## What it does
    Looks, in what loading reaches, for directory listings that are searched by the beginning of a name (`run-1` also
    finds `run-1-other` and `run-10`), for a step that is tried and, where it is missing, followed by the choice of
    any other (also one that a helper has listed before), for a step that matches its multiples by ten, and for files
    that are taken from whichever neighbouring run has one.

    ## Why it matters
    The results of an evaluation are then those of other weights than its label says. It happens when a training run was
    not copied completely, that is, unnoticed.

    ## Example
    `max(folder.glob(f"step_{step}*"))`: step 5 loads step 50000.

    ## Use instead
    `xpl.checkpoint.resolve(config, self.policy_dir)`, which raises and lists what is there.

    ## Fix safety
    No automatic fix.
    """
    adapter = Adapter.of(source)
    for function in adapter.reach(*LOADING):
        listed = [node for node in function.nodes if last(called(node)) in _LISTS]
        for node, wanted in (*_prefixes(function, listed), *_patterns(listed)):
            yield Finding(
                f"a checkpoint {wanted!r} that does not exist is replaced by one whose name begins like it",
                **source.at(function.file, node),
                expected="an error that lists what is there",
                got=ast.unparse(node),
                fix=Fix("advice", "compare whole names, or use xpl.checkpoint.resolve"),
            )
        for node, how, wanted in _steps(adapter, function, listed):
            yield Finding(
                f"where {wanted} names a checkpoint that does not exist, the search goes on and loads another one",
                **source.start(function.file, node),
                expected="an error after the checkpoint was not found",
                got=how[:200],
                fix=Fix("advice", "raise at the end of this branch"),
            )
        for node, wanted in _scaled(function):
            yield Finding(
                f"a {wanted} of 5 also takes checkpoint 50, where that is the one that is there",
                **source.at(function.file, node),
                expected="the step that was asked for, and an error where it is missing",
                got=ast.unparse(node).split("\n")[0],
                fix=Fix("advice", "compare the numbers as they are"),
            )
        for node, wanted in _siblings(function):
            yield Finding(
                f"where the checkpoint lacks {wanted}, that of a neighbouring run is taken: the first in the folder",
                **source.start(function.file, node),
                expected="an error that names the missing file",
                got=ast.unparse(node).split("\n")[0],
                fix=Fix("advice", "look in the checkpoint's own folder only, and raise"),
            )


def _prefixes(function: Function, listed: list[ast.AST]) -> Iterator[tuple[ast.AST, str]]:
    """Yield `entry.startswith(prefix)` over a listing, where the prefix is made of a value and not constant."""
    made = assigned(function.nodes)
    for node in function.nodes if listed else ():
        if isinstance(node, ast.Call) and last(called(node)) == "startswith" and len(node.args) == 1:
            prefix = node.args[0]
            value = made.get(prefix.id, prefix) if isinstance(prefix, ast.Name) else prefix
            is_given = (
                isinstance(value, ast.Name) and value.id in parameters(function.node) and bool(_NAMED.search(value.id))
            )
            if is_given or (
                isinstance(value, ast.JoinedStr) and isinstance(next(iter(value.values), None), ast.FormattedValue)
            ):
                yield node, ast.unparse(_first_value(value)) if isinstance(value, ast.JoinedStr) else ast.unparse(value)


def _patterns(listed: list[ast.AST]) -> Iterator[tuple[ast.AST, str]]:
    """Yield `glob(f"...{value}*")`: a wildcard right behind a value, or behind a dash that names contain too."""
    for node in listed:
        patterns = [entry for entry in ast.walk(node) if isinstance(entry, ast.JoinedStr)]
        for pattern in patterns:
            for value, after in zip(pattern.values, pattern.values[1:], strict=False):
                if isinstance(value, ast.FormattedValue) and isinstance(after, ast.Constant):
                    wanted = ast.unparse(value.value)
                    is_step = _STEP.search(wanted) is not None
                    if re.match(r"\*" if is_step else r"[-_]?\*", str(after.value)):
                        yield node, wanted


def _first_value(pattern: ast.JoinedStr) -> ast.expr:
    return next(value.value for value in pattern.values if isinstance(value, ast.FormattedValue))


def _steps(adapter: Adapter, function: Function, listed: list[ast.AST]) -> Iterator[tuple[ast.AST, str, str]]:
    """Yield branches for a step that was given, from which the function goes on to another entry of the folder."""
    steps = _given_steps(function)
    if not steps:
        return
    entries = _entries(adapter, function)
    for node in function.of(ast.If):
        wanted = names(node.test) & steps
        if wanted and not node.orelse and not _ends(node.body) and not _denies(node.test):
            inside = [child for entry in node.body for child in ast.walk(entry)]
            tries = any(isinstance(child, ast.Return) for child in inside)
            raises = any(isinstance(child, ast.Raise) for child in inside)
            after = [*listed, *_chosen(function.nodes, entries)]
            if tries and not raises and any(getattr(one, "lineno", 0) > (node.end_lineno or 0) for one in after):
                yield node, f"if {ast.unparse(node.test)}: ..., and then a search of the folder", min(wanted)
    yield from _otherwise(function, steps, entries)


def _otherwise(function: Function, steps: set[str], entries: set[str]) -> Iterator[tuple[ast.AST, str, str]]:
    """Yield where one entry is searched by its step, and another one chosen where none has it."""
    for node in function.of(ast.If):
        name, is_missing = _asked(node.test)
        wanted = _sought(function, name, steps)
        block = node.body if is_missing else node.orelse
        if wanted and any(_chosen(ast.walk(entry), entries) for entry in block):
            yield node, f"if {ast.unparse(node.test)}: ..., and otherwise another entry", wanted
    yield from _nearest(function, steps, entries)
    yield from _tried(function, steps, entries)
    for loop in function.of(ast.For):
        compared = [child for child in ast.walk(loop) if isinstance(child, ast.Compare)]
        found = {name for child in compared for name in names(child)} & steps
        if found and any(_chosen(ast.walk(entry), entries) for entry in loop.orelse):
            yield loop, f"for {ast.unparse(loop.target)} in ...: ..., else another entry", min(found)
    for call in function.of(ast.Call):
        if called(call) == "next" and len(call.args) > 1:
            found = _sifted_by(call.args[0]) & steps
            if found and any(_picks(child) and names(child) & entries for child in ast.walk(call.args[1])):
                yield call, ast.unparse(call), min(found)


def _tried(function: Function, steps: set[str], entries: set[str]) -> Iterator[tuple[ast.AST, str, str]]:
    """Yield where a test finds the entry of a step, or finds it missing, and another one takes its place."""
    for node in function.of(ast.If):
        wanted, missed = _found_by(function, node.test, steps), _missed_by(function, node.test, steps)
        if missed and not leaves(node.body) and any(_chosen(ast.walk(entry), entries) for entry in node.body):
            yield node, f"if {ast.unparse(node.test)}: another entry", missed
        elif wanted and not missed and not node.orelse and leaves(node.body) and _falls_to(function, node, entries):
            yield node, f"if {ast.unparse(node.test)}: ..., and then another entry", wanted


def _nearest(function: Function, steps: set[str], entries: set[str]) -> Iterator[tuple[ast.AST, str, str]]:
    """Yield where the entry that is nearest to the step is taken."""
    for call in function.of(ast.Call):
        nearest = {name for one in call.keywords if one.arg == "key" for name in names(one.value)} & steps
        if called(call) in {"min", "max"} and nearest and names(call) & entries:
            yield call, ast.unparse(call), min(nearest)


def _found_by(function: Function, test: ast.expr, steps: set[str]) -> str | None:
    """Return the step whose entry a test finds: `path.is_file()` of a path that it makes, `step in found`."""
    made: dict[str, set[str]] = {}
    for setting in function.of(ast.Assign):
        for target in targets(setting):
            if isinstance(target, ast.Name):
                made.setdefault(target.id, set()).update(names(setting.value) & steps)
    for node in ast.walk(test):
        asked: set[str] = set()
        if isinstance(node, ast.Call) and last(called(node)) in _EXISTS:
            asked = names(node)
        elif isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.In):
            asked = names(node.left)
        wanted = (asked & steps) | {step for name in asked for step in made.get(name, ())}
        if wanted:
            return min(wanted)
    return None


def _missed_by(function: Function, test: ast.expr, steps: set[str]) -> str | None:
    """Return the step whose entry a test finds missing: `name not in names`, `not path.exists()`."""
    if isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not):
        return _found_by(function, test.operand, steps)
    if isinstance(test, ast.Compare) and isinstance(test.ops[0], ast.NotIn):
        return _found_by(function, ast.Compare(test.left, [ast.In()], test.comparators), steps)
    return None


def _falls_to(function: Function, node: ast.stmt, entries: set[str]) -> bool:
    """Tell whether what comes after a statement, before anything raises or returns, is another entry's choice."""
    inner: ast.AST = node
    for outer in enclosing(node, function.up):
        for block in (getattr(outer, name, None) for name in ("body", "orelse")):
            for statement in block[block.index(inner) + 1 :] if isinstance(block, list) and inner in block else ():
                if _chosen(ast.walk(statement), entries):
                    return True
                if isinstance(statement, (ast.Raise, ast.Return)):
                    return False
        if outer is function.node:
            break
        inner = outer
    return False


def _given_steps(function: Function) -> set[str]:
    """Return the names that hold the step that was asked for: read from the configuration, handed in, or made of it."""
    steps = {name for name in parameters(function.node) if _STEP.search(name)}
    found: set[str] = set()
    for node in function.of(ast.Assign):
        keys = {read.key for child in ast.walk(node.value) if (read := key_read(child)) is not None}
        made_of = node.value.args if isinstance(node.value, ast.Call) else [node.value]
        is_handed_on = any(isinstance(part, ast.Name) and part.id in found | steps for part in made_of)
        if any(_STEP.search(key) for key in keys) or is_handed_on:
            found.update(target.id for target in targets(node) if isinstance(target, ast.Name))
    asked = {name for name in steps if _may_be_none(function, name)}
    return found | asked


def _may_be_none(function: Function, name: str) -> bool:
    """Tell whether a parameter may be left out; only then does a test for it mean that it was given."""
    arguments = [*function.node.args.posonlyargs, *function.node.args.args, *function.node.args.kwonlyargs]
    noted = next((argument.annotation for argument in arguments if argument.arg == name), None)
    asked = (node for node in function.of(ast.Compare) if isinstance(node.left, ast.Name) and node.left.id == name)
    return (noted is not None and "None" in ast.unparse(noted)) or any(
        isinstance(node.ops[0], (ast.Is, ast.IsNot)) for node in asked
    )


def _entries(adapter: Adapter, function: Function) -> set[str]:
    """Return the names that hold entries of a folder, listed here or by a helper, sifted or not."""
    found: set[str] = set()
    for _ in range(3):
        for node in function.of(ast.Assign):
            if _lists(adapter, function, node.value, found):
                found.update(target.id for target in targets(node) if isinstance(target, ast.Name))
        for call in function.of(ast.Call):
            holder = call.func.value if isinstance(call.func, ast.Attribute) else None
            adds = last(called(call)) in {"append", "extend"}
            if adds and isinstance(holder, ast.Name) and any(_lists(adapter, function, x, found) for x in call.args):
                found.add(holder.id)
    return found


def _lists(adapter: Adapter, function: Function, node: ast.AST, known: set[str]) -> bool:
    """Tell whether an expression is made of a folder's entries."""
    for child in ast.walk(node):
        if isinstance(child, ast.Call):
            helper = adapter.callee(function, child)
            calls = helper.of(ast.Call) if helper is not None else [child]
            if any(last(called(call)) in _LISTS for call in calls):
                return True
        elif isinstance(child, ast.Name) and child.id in known:
            return True
    return False


def _chosen(nodes: Iterable[ast.AST], entries: set[str]) -> list[ast.AST]:
    """Return where one of many entries is taken by its place: the greatest, the first, the last."""
    return [
        child
        for node in nodes
        if isinstance(node, (ast.Return, ast.Assign)) and node.value is not None
        for child in ast.walk(node.value)
        if _picks(child) and names(child) & entries
    ]


def _picks(node: ast.AST) -> bool:
    if isinstance(node, ast.Subscript):
        return constant(node.slice) in {0, -1}
    return last(called(node)) in {"max", "min"}


def _asked(test: ast.expr) -> tuple[str, bool]:
    """Return the name that a test asks for, and whether the test holds where there is nothing."""
    if isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not) and isinstance(test.operand, ast.Name):
        return test.operand.id, True
    if isinstance(test, ast.Compare) and isinstance(test.left, ast.Name) and constant(test.comparators[0]) is None:
        return test.left.id, isinstance(test.ops[0], ast.Is)
    return (test.id if isinstance(test, ast.Name) else ""), False


def _sought(function: Function, name: str, steps: set[str]) -> str | None:
    """Return the step by which entries were sifted into a name: `exact = [e for e in all if ... == step]`."""
    for node in function.of(ast.Assign) if name else ():
        if any(isinstance(target, ast.Name) and target.id == name for target in targets(node)):
            wanted = _sifted_by(node.value) & steps
            if wanted:
                return min(wanted)
    return None


def _sifted_by(node: ast.AST) -> set[str]:
    sifts = (child for child in ast.walk(node) if isinstance(child, ast.comprehension))
    return {name for sift in sifts for condition in sift.ifs for name in names(condition)}


def _ends(body: list[ast.stmt]) -> bool:
    """Tell whether nothing comes after a block: it leaves, or ends by a loop that leaves where it found nothing."""
    final = body[-1]
    return leaves(body) or (isinstance(final, (ast.For, ast.While)) and leaves(final.orelse))


def _denies(test: ast.expr) -> bool:
    """Tell whether a test asks that there is no step, so that its branch is for those who named none."""
    if isinstance(test, ast.UnaryOp):
        return isinstance(test.op, ast.Not)
    return isinstance(test, ast.Compare) and isinstance(test.ops[0], (ast.Is, ast.In)) and constant(test.left) is ...


def _scaled(function: Function) -> Iterator[tuple[ast.AST, str]]:
    """Yield a step that also matches itself times ten: `while ...: step *= 10`, `{step, step * 10}`."""
    steps = _given_steps(function)
    for node in function.of(ast.AugAssign):
        if isinstance(node.op, ast.Mult) and constant(node.value) in _TENS and names(node.target) & steps:
            yield node, min(names(node.target) & steps)
    for product in function.of(ast.BinOp):
        wanted = names(product) & steps
        inside = any(isinstance(outer, ast.Compare) for outer in enclosing(product, function.up))
        if inside and wanted and isinstance(product.op, ast.Mult) and constant(product.right) in _TENS:
            yield product, min(wanted)


def _siblings(function: Function) -> Iterator[tuple[ast.AST, str]]:
    """Yield loops over the folder above the one that was asked for, which take a file of the first run that has one."""
    above = {
        target.id
        for node in function.of(ast.Assign)
        if _leads_up(node.value)
        for target in targets(node)
        if isinstance(target, ast.Name)
    }
    for loop in function.of(ast.For):
        listing = next((call for call in ast.walk(loop.iter) if last(called(call)) in _LISTS), None)
        if listing is None or not (names(listing) & above or _leads_up(listing)):
            continue
        entry = loop.target.id if isinstance(loop.target, ast.Name) else ""
        bound = {entry} | {
            target.id
            for node in ast.walk(loop)
            if isinstance(node, ast.Assign) and entry in names(node.value)
            for target in targets(node)
            if isinstance(target, ast.Name)
        }
        for node in ast.walk(loop):
            asked = {last(called(call)) for call in ast.walk(node.test)} if isinstance(node, ast.If) else set()
            if not isinstance(node, ast.If) or not asked & _EXISTS or not names(node.test) & bound:
                continue
            leaving = isinstance(node.body[-1], (ast.Return, ast.Break))
            taken = [child.value for child in node.body if isinstance(child, (ast.Return, ast.Assign)) and child.value]
            wanted = [text for text in texts(loop) if "." in text]
            if leaving and taken and names(taken[0]) & bound and not any(_selects(outer, entry) for outer in loop.body):
                yield loop, wanted[0] if wanted else "what it looks for"


def _selects(node: ast.stmt, entry: str) -> bool:
    """Tell whether a loop compares the entry's name with something, so that not any entry will do."""
    return any(
        isinstance(child, ast.Compare) and any(f"{entry}.name" in ast.unparse(part) for part in ast.walk(child))
        for child in ast.walk(node)
    )


def _leads_up(node: ast.AST) -> bool:
    return any(
        (isinstance(child, ast.Attribute) and child.attr in {"parent", "parents"}) or last(called(child)) == "dirname"
        for child in ast.walk(node)
    ) and not any(isinstance(child, ast.Name) and child.id == "__file__" for child in ast.walk(node))
