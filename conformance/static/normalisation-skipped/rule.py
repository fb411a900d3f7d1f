"""XPL148: Missing normalisation statistics are an error."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, LOADING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, dotted, last, parameters, targets

_STATISTICS = re.compile(r"(^|_)(stats?|statistics|mean|std|q01|q99|minmax|scaler|normali[sz]er|normstats?)(_|$|\d)")
_NORMALISES = re.compile(r"normali[sz]|denorm|(^|_)(un)?norm(_|$)|unscale|rescale", re.IGNORECASE)


@rule(code="XPL148", requirement="XPL-ACT-12")
def normalisation_skipped(source: Source) -> Iterator[Finding]:
    """Values are passed on unnormalised if statistics are missing.

    ## What it does
    Looks for functions that normalise, and return their input unchanged if statistics are missing, and for branches
    that normalise only if statistics exist, without an `else`. Not reported if `__init__` or `load` raises an error for
    missing statistics, nor for a normaliser that is looked up among the steps of a pipeline which the adapter also
    applies as a whole: where that has none, every other value is unnormalised, too, as it was in training.

    ## Why it matters
    The network then gets joint angles in another scale than in training, or its outputs between -1 and 1 are executed
    as radians. The shapes fit and there is no error; the arm moves too little, or to a wrong pose.

    ## Example
    `if self.stats is not None: action = action * self.stats["std"] + self.stats["mean"]`.

    ## Use instead
    Load statistics in `load` unconditionally, and raise an error if a key is missing.

    ## Fix safety
    No automatic fix: a policy that was trained without normalisation declares it in its configuration.
    """
    adapter = ModelClass.of(source)
    settled: set[str] | None = None
    reported: set[str] = set()
    for function in adapter.reach(*OBSERVING, *ACTING):
        skips = [*_returned(function), *_fallen_through(function), *_branched(function)]
        for node, statistics, why in skips:
            settled = _settled(adapter) if settled is None else settled
            if {statistics, str(id(node))} & (settled | reported):
                continue
            if _is_step_of_applied(adapter, function, statistics):
                continue
            reported |= {statistics, str(id(node))}
            yield Finding(
                f"if {statistics} {why}, {function.name} passes values on unnormalised: numbers between -1 and "
                "1 are treated as radians, or vice versa",
                **source.start(function.file, node),
                expected="an error if statistics are missing",
                got=ast.unparse(node).split("\n")[0],
                fix=Fix("advice", f"raise an error if {statistics} {why}; a policy without normalisation declares it"),
                must=False,  # of public adapters' findings, too few were right (docs/calibration.md)
            )


def _settled(adapter: ModelClass) -> set[str]:
    """Return the statistics for which construction raises, or that it sets without a condition to what a call gives."""
    required: set[str] = set()
    for function in adapter.reach(*LOADING):
        for node in function.of(ast.If):
            if any(isinstance(child, ast.Raise) for child in node.body):
                required |= {name for name, _ in _missing(node.test)}
    attributes: dict[str, list[ast.expr]] = {}
    for function in adapter.reach(*LOADING):
        for setting in function.of(ast.Assign, ast.AnnAssign):
            value = getattr(setting, "value", None)
            for target in targets(setting) if isinstance(value, ast.expr) else ():
                if _is_statistics(target) and value is not None:
                    attributes.setdefault(dotted(target), []).append(value)
    return required | {
        name
        for name, values in attributes.items()
        if all(isinstance(value, ast.Call) and not _may_be_none(adapter, value) for value in values)
    }


def _is_step_of_applied(adapter: ModelClass, function: Function, statistics: str) -> bool:
    """Tell whether statistics are a step, or None, of a pipeline that the adapter applies as a whole."""
    acting = adapter.reach(*OBSERVING, *ACTING)
    applied = {called(call) for other in acting for call in other.of(ast.Call)}
    for owner, name in _origins(adapter, function, statistics):
        for value in _given(adapter, owner, name):
            pipeline = _searched(value)
            if pipeline and _aliases(owner, pipeline) & (applied | {name.rpartition(".")[0] for name in applied}):
                return True
    return False


def _origins(adapter: ModelClass, function: Function, name: str) -> Iterator[tuple[Function, str]]:
    """Yield where a name of a function comes from: itself, or what callers give for this parameter."""
    yield function, name
    if name not in parameters(function.node):
        return
    for caller in adapter.reach(*LOADING, *OBSERVING, *ACTING):
        for call in caller.of(ast.Call):
            if adapter.callee(caller, call) is function:
                arguments = list(zip(parameters(function.node), call.args, strict=False))
                arguments += [(keyword.arg, keyword.value) for keyword in call.keywords if keyword.arg]
                yield from ((caller, dotted(value)) for key, value in arguments if key == name and dotted(value))


def _given(adapter: ModelClass, function: Function, name: str) -> Iterator[ast.expr]:
    """Yield what a name of a function, or an attribute of the class, is assigned."""
    functions = adapter.reach(*LOADING) if name.startswith("self.") else [function]
    yield from (value for other in functions for target, value in other.assignments if dotted(target) == name)


def _searched(value: ast.expr) -> str:
    """Return the pipeline in whose steps `next(... for step in pipeline.steps ..., None)` looks for one; "" if none."""
    if called(value) != "next" or not isinstance(value, ast.Call) or not isinstance(value.args[0], ast.GeneratorExp):
        return ""
    searched = value.args[0].generators[0].iter
    return dotted(searched.value) if isinstance(searched, ast.Attribute) else dotted(searched)


def _aliases(function: Function, name: str) -> set[str]:
    """Return a name with the attributes that are the same object, assigned from it or with it."""
    same = {dotted(target) for target, value in function.assignments if dotted(value) == name}
    return {name, *same} - {""}


def _may_be_none(adapter: ModelClass, call: ast.Call) -> bool:
    """Tell whether a call may give None: a look-up, a search, or a function of the adapter that returns it."""
    if last(called(call)) == "get":
        return True
    if called(call) == "next":
        return len(call.args) > 1 and constant(call.args[1]) is None
    for function in adapter.reach(*LOADING):
        if function.name == last(called(call)):
            returns = [node.value for node in function.of(ast.Return)]
            return any(value is None or constant(value) is None or _is_empty(value) for value in returns)
    return False


def _is_empty(value: ast.expr) -> bool:
    return isinstance(value, ast.Dict) and not value.keys


def _missing(test: ast.expr) -> Iterator[tuple[str, str]]:
    """Yield the statistics that a test finds missing, as a whole or an entry of them."""
    if isinstance(test, ast.BoolOp) and isinstance(test.op, ast.Or):
        for value in test.values:
            yield from _missing(value)
    elif isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not) and _is_statistics(test.operand):
        yield dotted(test.operand), "is missing"
    elif isinstance(test, ast.Compare) and len(test.ops) == 1:
        left, right = test.left, test.comparators[0]
        if isinstance(test.ops[0], ast.Is) and constant(right) is None and _is_statistics(left):
            yield dotted(left), "is missing"
        elif isinstance(test.ops[0], ast.NotIn) and _is_statistics(right):
            yield dotted(right), f"lacks {ast.unparse(left)}"


def _is_statistics(node: ast.expr) -> bool:
    return bool(_STATISTICS.search(last(dotted(node)).lower()))


def _returned(function: Function) -> Iterator[tuple[ast.AST, str, str]]:
    """Yield early returns of a parameter as it came, in a function that normalises."""
    if not _NORMALISES.search(function.name):
        return
    parameter_names = set(parameters(function.node))
    for node in function.of(ast.If):
        if isinstance(node.body[-1], ast.Return):
            value = node.body[-1].value
            while isinstance(value, ast.Call) and value.args:
                value = value.args[0]
            if isinstance(value, ast.Name) and value.id in parameter_names:
                yield from ((node, name, why) for name, why in _missing(node.test))


def _fallen_through(function: Function) -> Iterator[tuple[ast.AST, str, str]]:
    """Yield the last line of a function that normalises, which returns a parameter where no statistics were found."""
    final = function.node.body[-1]
    if not _NORMALISES.search(function.name) or not isinstance(final, ast.Return):
        return
    if not isinstance(final.value, ast.Name) or final.value.id not in parameters(function.node):
        return
    for node in function.node.body[:-1]:
        if isinstance(node, ast.If) and isinstance(node.body[-1], ast.Return):
            for name in _found(node.test):
                if any(_applies(entry, name) for entry in node.body):
                    yield final, name, "is missing"


def _found(test: ast.expr) -> Iterator[str]:
    """Yield the statistics that a test finds: also an entry of them, as in `"mean" in stats`."""
    yield from _present(test)
    for node in ast.walk(test):
        owner: ast.expr | None = None
        if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.In):
            owner = node.comparators[0]
        elif isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.IsNot) and isinstance(node.left, ast.Call):
            owner = node.left.func.value if isinstance(node.left.func, ast.Attribute) else None
        if owner is not None and _is_statistics(owner):
            yield dotted(owner)


def _branched(function: Function) -> Iterator[tuple[ast.AST, str, str]]:
    """Yield branches that normalise only where statistics are there."""
    for node in function.of(ast.If, ast.IfExp):
        if isinstance(node, ast.IfExp):
            body: list[ast.AST] = [node.body]
            other = isinstance(node.orelse, ast.Name)
        elif isinstance(node, ast.If):
            body, other = list(node.body), not node.orelse and not isinstance(node.body[-1], ast.Return)
        else:
            continue
        if isinstance(node, ast.IfExp) and isinstance(node.body, ast.Name):
            for name, why in _missing(node.test):
                if _applies(node.orelse, name):
                    yield node, name, why
        for name in _present(node.test) if other else ():
            if any(_applies(entry, name) for entry in body):
                yield node, name, "is missing"


def _present(test: ast.expr) -> Iterator[str]:
    if isinstance(test, ast.BoolOp) and isinstance(test.op, ast.And):
        for value in test.values:
            yield from _present(value)
    elif isinstance(test, ast.Compare) and isinstance(test.ops[0], ast.IsNot) and _is_statistics(test.left):
        yield dotted(test.left)
    elif _is_statistics(test):
        yield dotted(test)


def _applies(node: ast.AST, statistics: str) -> bool:
    """Tell whether a branch changes a value by the statistics: arithmetic with them, or a function that normalises."""
    for child in ast.walk(node):
        if isinstance(child, ast.BinOp) and any(statistics == dotted(part) for part in ast.walk(child)):
            return True
        if isinstance(child, ast.Call) and _NORMALISES.search(last(called(child))):
            return True
    return False
