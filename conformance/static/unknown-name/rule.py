"""XPL154: An unknown task or robot is an error."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, LOADING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import (
    assigned,
    called,
    constant,
    dotted,
    enclosing,
    key_read,
    last,
    names,
    targets,
    texts,
)

_NAMES = re.compile(r"(^|_)(task|bench|robot|embodiment|env_cfg|dataset|domain|unnorm|suite)(_|$|s$)", re.IGNORECASE)

_ROBOTS = re.compile(r"^(robot(_name|_type)?|embodiment(_name)?|env_cfg(_type)?|robot_cfg)$")

_STATISTICS: Final = re.compile(
    r"(?:^|_)(?:un|de)?norm(?:ali[sz]\w*)?(?:_|$)|stats?(?:_|$)|statistics|quantile|(?:^|_)(?:mean|std)(?:_|$)"
)


@rule(code="XPL154", requirement="XPL-CFG-8")
def unknown_name(source: Source) -> Iterator[Finding]:
    """An unknown task, robot or dataset is replaced by another one.

    ## What it does
    Looks for look-ups by the name of a task, robot or dataset in a table whose fallback is another entry or a constant:
    `TABLE.get(task, 0)`, `if key not in table: key = next(iter(table))`. A fallback to None or to the name itself is
    not reported: the code handles both later. A default robot if none was named is a warning.

    ## Why it matters
    A misspelt or new task runs with the embedding, the prompt or the statistics of another one. The policy moves
    plausibly, and its score is recorded under a task that it did not run.

    ## Example
    `task_id = TASK_IDS.get(config["task_name"], 0)`.

    ## Use instead
    `TASK_IDS[config["task_name"]]`, or an error that lists the known names.

    ## Fix safety
    Safe: `[name]` in place of `.get(name, default)` raises an error if the name is unknown, as it should.
    """
    adapter = ModelClass.of(source)
    for function in adapter.reach(*LOADING):
        for node, name, robot in _robots(function):
            yield Finding(
                f"without {name} the robot is {robot!r}: dimensions and keys are then that robot's; every "
                "launcher may name one",
                **source.at(function.file, node),
                expected="an error if no robot is named",
                got=ast.unparse(node).split("\n")[0],
                fix=Fix("advice", f"read {name} with [...], and raise an error if it is missing"),
                must=False,
            )
    for function in adapter.reach(*LOADING, *OBSERVING, *ACTING):
        for node, name, instead in (*_defaults(function), *_first(function)):
            consequence = (
                "values are scaled by statistics of another task or robot, and the arm moves too little, or elsewhere"
                if _selects_statistics(node, function)
                else "the run is recorded under a name that the policy did not get"
            )
            yield Finding(
                f"an unknown {name} is treated as {instead}: {consequence}",
                **source.at(function.file, node),
                expected="an error that lists the known names",
                got=ast.unparse(node).split("\n")[0],
                fix=Fix("advice", "look the name up with [...], or raise an error with the known names"),
            )


def _selects_statistics(node: ast.AST, function: Function) -> bool:
    """Tell whether statistics are what is looked up, or what the name is then used for."""
    statement = next((outer for outer in (node, *enclosing(node, function.up)) if isinstance(outer, ast.stmt)), node)
    branch = function.up.get(statement)
    looked_up = [statement, branch.test if isinstance(branch, ast.If) else statement]
    words = {word for part in looked_up for word in _words(part)}
    bound = {dotted(target) for target in targets(statement)} - {""}
    for use in function.of(ast.Subscript):
        if dotted(use.slice) in bound:
            words |= _words(use.value)
    return any(_STATISTICS.search(word.lower()) for word in words)


def _words(node: ast.AST) -> set[str]:
    """Return the names and attributes below a node, and the texts that are keys."""
    attributes = {child.attr for child in ast.walk(node) if isinstance(child, ast.Attribute)}
    keys = {text for child in ast.walk(node) if isinstance(child, ast.Subscript) for text in texts(child.slice)}
    return names(node) | attributes | keys


def _robots(function: Function) -> Iterator[tuple[ast.AST, str, str]]:
    """Yield where a robot that nobody named becomes a certain one."""
    for branch in function.of(ast.If):
        missing = _lacks(branch.test)
        for entry in branch.body if _ROBOTS.search(last(missing)) else ():
            value = constant(entry.value) if isinstance(entry, ast.Assign) else None
            if isinstance(value, str) and _is_robot(value) and any(dotted(one) == missing for one in targets(entry)):
                yield entry, last(missing), value
    for node in function.of(ast.Call, ast.BoolOp):
        read = key_read(node.values[0] if isinstance(node, ast.BoolOp) else node)
        default: ast.expr | None = None
        if isinstance(node, ast.BoolOp):
            default = node.values[-1] if isinstance(node.op, ast.Or) else None
        elif read is not None:
            default = read.default
        value = constant(default)
        if read is not None and _ROBOTS.search(read.key) and isinstance(value, str) and _is_robot(value):
            yield node, read.key, value


def _lacks(test: ast.expr) -> str:
    """Return what a test finds missing: `robot is None`, `not robot`."""
    if isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not):
        return dotted(test.operand)
    if isinstance(test, ast.Compare) and isinstance(test.ops[0], ast.Is) and constant(test.comparators[0]) is None:
        return dotted(test.left)
    return ""


def _is_robot(name: str) -> bool:
    """Tell whether a text names one robot: none of the words for any, or for none."""
    return bool(name) and name.lower() not in {"default", "none", "unknown", "auto", "robot", "any", "null"}


def _defaults(function: Function) -> Iterator[tuple[ast.AST, str, str]]:
    """Yield `table.get(name, default)` with the default of another entry."""
    for node in function.of(ast.Call):
        if not isinstance(node.func, ast.Attribute) or node.func.attr != "get":
            continue
        if len(node.args) != 2 or constant(node.args[0]) is not ...:
            continue
        key, default = node.args
        name = last(dotted(key)) or (str(constant(key.slice)) if isinstance(key, ast.Subscript) else "")
        if not _NAMES.search(name) or not _is_table(node.func.value, function) or _says_nothing(default):
            continue
        if not names(default) & names(key) - {"self"} and not _selects_import(node, function):
            yield node, name, ast.unparse(default)


def _selects_import(node: ast.AST, function: Function) -> bool:
    """Tell whether what is looked up is the name of a module or class to import, which then speaks for itself."""
    statement = next((outer for outer in enclosing(node, function.up) if isinstance(outer, ast.stmt)), None)
    bound = {name for target in targets(statement) for name in names(target)} if statement is not None else set()
    for call in function.of(ast.Call):
        if last(called(call)) in {"import_module", "__import__", "getattr"}:
            argument_nodes = [child for argument in call.args for child in ast.walk(argument)]
            if node in argument_nodes or any(
                isinstance(child, ast.Name) and child.id in bound for child in argument_nodes
            ):
                return True
    return False


def _is_table(node: ast.expr, function: Function) -> bool:
    """Tell whether something is a table by names: a constant of the module, a map in place, or so called."""
    if isinstance(node, ast.Dict):
        return True
    name = last(dotted(node))
    if name.isupper() or isinstance(assigned(function.of(ast.Assign)).get(name), ast.Dict):
        return True
    return bool(re.search(r"map$|ids?$|table|2|_to_", name))


def _says_nothing(default: ast.expr) -> bool:
    """Tell whether a default is no entry: None, an empty map or text."""
    value = constant(default)
    return value is None or value == "" or ast.unparse(default) in {"{}", "[]"}


def _first(function: Function) -> Iterator[tuple[ast.AST, str, str]]:
    """Yield names that are replaced by the first one of a table where the table lacks them."""
    for node in function.of(ast.If):
        if not isinstance(node.test, ast.Compare):
            continue
        if not isinstance(node.test.ops[0], ast.NotIn):
            continue
        name = dotted(node.test.left)
        if not name or not _NAMES.search(last(name)):
            continue
        firsts = {
            target.id
            for entry in node.body
            if isinstance(entry, ast.Assign) and _is_first(entry.value, dotted(node.test.comparators[0]))
            for target in targets(entry)
            if isinstance(target, ast.Name)
        }
        for entry in node.body:
            value = entry.value if isinstance(entry, (ast.Assign, ast.Return)) else None
            replaced = isinstance(entry, ast.Return) or any(dotted(target) == name for target in targets(entry))
            table = dotted(node.test.comparators[0])
            if value is not None and replaced and (_is_first(value, table) or dotted(value) in firsts):
                yield entry, last(name), f"the first of {table}" if dotted(value) in firsts else ast.unparse(value)


def _is_first(value: ast.expr, table: str) -> bool:
    """Tell whether a value is a constant name, or one that the table happens to begin with."""
    text = constant(value)
    begins = any(last(called(node)) in {"next", "list", "sorted"} for node in ast.walk(value))
    return (isinstance(text, str) and bool(text)) or (begins and any(dotted(node) == table for node in ast.walk(value)))
