"""XPL128: Weights are loaded completely."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import LOADING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, last, names, targets

_REPORTS = frozenset(("print", "len", "info", "warning", "debug", "sorted", "list", "str"))
_LOADS = frozenset(("load_state_dict", "load_model", "load_weights", "load_checkpoint"))


@rule(code="XPL128", requirement="XPL-CKP-4")
def partial_weights(source: Source) -> Iterator[Finding]:
    """Missing or unexpected weights are accepted.

    ## What it does
    Looks for `strict=False` where weights are loaded, without an error for the keys that the call reports as missing or
    unexpected.

    ## Why it matters
    A layer whose weights are missing keeps random ones. The policy runs, moves, and scores like a policy that was
    hardly trained.

    ## Example
    `missing, unexpected = model.load_state_dict(weights, strict=False)`, both printed.

    ## Use instead
    `strict=True`. If keys are left out on purpose, list them and raise an error for all others.

    ## Fix safety
    No automatic fix: an incomplete checkpoint then raises an error, as it should.
    """
    reached = {id(function.node) for function in ModelClass.of(source).reach(*LOADING)}
    for name in source.reached(sdk.File.MODEL_PY):
        for function in source.functions(name) if any(word in source.text(name) for word in _LOADS) else ():
            if "/" not in name or id(function.node) in reached:  # a library's own loaders are not the adapter's
                for call in _lenient(function):
                    if not _is_checked(function, call):
                        yield Finding(
                            "weights that the checkpoint lacks stay random, without an error",
                            **source.at(name, call),
                            expected="strict=True, or an error for missing and unexpected keys",
                            got=ast.unparse(call),
                            fix=Fix(
                                "advice",
                                (
                                    "load with strict=True, or raise an error for every key that is not expected "
                                    "to be missing"
                                ),
                            ),
                        )


def _lenient(function: Function) -> Iterator[ast.Call]:
    for node in function.nodes:
        if isinstance(node, ast.Call) and last(called(node)) in _LOADS:
            strict = next((entry.value for entry in node.keywords if entry.arg == "strict"), None)
            if constant(strict) is False:
                yield node


def _is_checked(function: Function, call: ast.Call) -> bool:
    """Tell whether what the call reports leads to an error, or is handed on to somebody who may look."""
    parent = function.up.get(call)
    if not isinstance(parent, ast.Assign):
        return isinstance(parent, ast.Return)
    results = {name for target in targets(parent) for name in names(target)} - {"_"}
    return any(_checks(node, results) for node in function.nodes)


def _checks(node: ast.AST, results: set[str]) -> bool:
    if isinstance(node, ast.If):
        return bool(names(node.test) & results) and any(
            isinstance(child, ast.Raise) for entry in node.body for child in ast.walk(entry)
        )
    if isinstance(node, ast.Assert):
        return bool(names(node.test) & results)
    if isinstance(node, ast.Call) and last(called(node)) not in _REPORTS:
        return any(isinstance(value, ast.Name) and value.id in results for value in node.args)
    return False
