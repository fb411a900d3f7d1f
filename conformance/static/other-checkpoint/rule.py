"""XPL126: A checkpoint that does not exist is an error."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import LOADING, Adapter
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import assigned, called, key_read, last, leaves, names, parameters, targets

_LISTS = frozenset(("listdir", "iterdir", "glob", "rglob", "iglob", "scandir"))
_NAMED = re.compile(r"ckpt|checkpoint|name|run|step|num", re.IGNORECASE)
_STEP = re.compile(r"step|num|iter|epoch", re.IGNORECASE)


@rule(code="XPL126", requirement="XPL-CKP-1")
def other_checkpoint(source: Source) -> Iterator[Finding]:
    """A checkpoint that was asked for and does not exist is replaced by another one.

    ## What it does
    Looks, in what loading reaches, for directory listings that are searched by the beginning of a name (`run-1` also
    finds `run-1-other` and `run-10`), and for a step that is tried and, where it is missing, followed by a search for
    any other.

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
    for function in Adapter.of(source).reach(*LOADING):
        listed = [node for node in function.nodes if last(called(node)) in _LISTS]
        for node, wanted in (*_prefixes(function, listed), *_patterns(listed)):
            yield Finding(
                f"a checkpoint {wanted!r} that does not exist is replaced by one whose name begins like it",
                **source.at(function.file, node),
                expected="an error that lists what is there",
                got=ast.unparse(node),
                fix=Fix("advice", "compare whole names, or use xpl.checkpoint.resolve"),
            )
        for node, wanted in _steps(function, listed):
            yield Finding(
                f"where {wanted} names a checkpoint that does not exist, the search goes on and loads another one",
                **source.start(function.file, node),
                expected="an error after the checkpoint was not found",
                got=f"if {ast.unparse(node.test)}: ..., and then a search of the folder",
                fix=Fix("advice", "raise at the end of this branch"),
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


def _steps(function: Function, listed: list[ast.AST]) -> Iterator[tuple[ast.If, str]]:
    """Yield branches for a step that was given, from which the function goes on to a search of the folder."""
    steps: set[str] = set()
    for node in function.nodes:
        if isinstance(node, ast.Assign):
            keys = (read.key for child in ast.walk(node.value) if (read := key_read(child)) is not None)
            if any(_STEP.search(key) for key in keys):
                steps.update(target.id for target in targets(node) if isinstance(target, ast.Name))
    for node in function.nodes:
        if isinstance(node, ast.If) and names(node.test) & steps and not leaves(node.body) and not node.orelse:
            tries = any(isinstance(child, ast.Return) for entry in node.body for child in ast.walk(entry))
            searches = any(getattr(call, "lineno", 0) > (node.end_lineno or 0) for call in listed)
            if tries and searches:
                yield node, min(names(node.test) & steps)
