"""XPL141: get_action leaves the stored observation unchanged."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, LOADING, OBSERVING, RESETTING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, enclosing, last, names, parameters, self_attribute, targets

_SAME_AGAIN = frozenset(("asarray", "array", "ascontiguousarray", "as_tensor", "astype", "float", "str", "int", "list"))
"""Conversions that change nothing the second time."""
_DROPS = frozenset(("clear", "pop", "popitem", "popleft"))


@rule(code="XPL141", requirement="XPL-EPI-5")
def inference_mutates_observation(source: Source) -> Iterator[Finding]:
    """get_action changes or drops the stored observation.

    ## What it does
    Collects the attributes that `update_obs` fills, follows them through `get_action`, and looks for entries that are
    overwritten by a value computed from themselves, entries that are removed, and attributes that are emptied. Queues
    that `get_action` fills itself are not reported.

    ## Why it matters
    A client that calls `get_action` again, after a time-out for example, gets an exception, or an action from an image
    that was normalised twice.

    ## Example
    `obs = self.latest; obs["image"] = self.transform(obs["image"])` in `get_action`.

    ## Use instead
    A new dict for the model's inputs: `{**obs, "image": self.transform(obs["image"])}`.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    observing = adapter.reach(*OBSERVING)
    elsewhere = {id(function.node) for function in [*observing, *adapter.reach(*RESETTING, *LOADING)]}
    acting = [function for function in adapter.reach(*ACTING) if id(function.node) not in elsewhere]
    filled_here = {write.attribute for one in acting for write in one.writes if not _is_emptied(write.node)}
    stored = {write.attribute for one in observing for write in one.writes}
    stored = {name for name in stored if name not in filled_here or _is_map(acting, name)}
    mutations: dict[int, tuple[Function, ast.AST, str]] = {}
    for function, shared in _given(adapter, stored):
        if function in acting:
            mutations |= {id(node): (function, node, what) for node, what in _changes(function, shared)}
    for function, node, attribute in _dropped(acting, stored - filled_here):
        mutations[id(node)] = (function, node, f"self.{attribute} is emptied")
    for function, node, what in mutations.values():
        yield Finding(
            (
                f"{what} while an action is computed: a second get_action on the same observation fails or gets "
                "another one"
            ),
            **source.at(function.file, node),
            expected="stored observations that only update_obs and reset change",
            got=ast.unparse(node).split("\n")[0],
            fix=Fix("advice", "build the model's inputs in a new dict, and leave the stored observation unchanged"),
        )


def _given(adapter: ModelClass, stored: set[str]) -> Iterator[tuple[Function, frozenset[str]]]:
    """Yield what acting calls with a stored observation, and the parameters that hold one."""
    waiting: list[tuple[Function, frozenset[str]]] = [
        (method, frozenset()) for method in map(adapter.method, ACTING) if method is not None
    ]
    for function, shared in waiting:  # grows while it is read
        yield function, shared
        for call in function.of(ast.Call):
            other = adapter.callee(function, call)
            if other is None:
                continue
            expected = [name for name in parameters(other.node) if name != "self"]
            arguments = [*zip(expected, call.args, strict=False), *((word.arg, word.value) for word in call.keywords)]
            handed = frozenset(
                name
                for name, value in arguments
                if name and (_self_stored(value, stored) or _is_shared(value, function, shared))
            )
            if (other, handed) not in waiting:
                waiting.append((other, handed))


def _self_stored(value: ast.expr, stored: set[str]) -> bool:
    """Tell whether an expression is a stored observation, or what one environment has in it."""
    return isinstance(value, (ast.Attribute, ast.Subscript)) and self_attribute(value) in stored


def _is_shared(value: ast.expr, function: Function, shared: frozenset[str]) -> bool:
    """Tell whether an expression is a parameter that holds a stored observation, before the name gets another value."""
    if not isinstance(value, ast.Name) or value.id not in shared:
        return False
    bound = (node for node in function.of(ast.Name) if node.id == value.id and isinstance(node.ctx, ast.Store))
    return value.lineno <= min((node.lineno for node in bound), default=value.lineno)


def _changes(function: Function, shared: frozenset[str]) -> Iterator[tuple[ast.AST, str]]:
    """Yield where a function takes an entry out of a parameter, or replaces it by what is made of it."""
    for node in function.of(ast.Call):
        is_taken = isinstance(node.func, ast.Attribute) and node.func.attr == "pop" and bool(node.args)
        if is_taken and _is_shared(_owner(node.func), function, shared) and not _is_guarded(node, function):
            yield node, f"{_named(node.args[0])} is removed"
    changes: list[ast.Assign | ast.AugAssign | ast.Delete] = [*function.of(ast.Assign), *function.of(ast.Delete)]
    for change in (*changes, *function.of(ast.AugAssign)):
        for target in [change.target] if isinstance(change, ast.AugAssign) else change.targets:
            if not isinstance(target, ast.Subscript) or not _is_shared(target.value, function, shared):
                continue
            is_new = not isinstance(change, ast.Assign) or _is_made_anew(change, ast.unparse(target), function)
            if is_new and not _is_guarded(change, function):
                yield change, f"{_named(target.slice)} is {'removed' if isinstance(change, ast.Delete) else 'changed'}"


def _owner(node: ast.expr) -> ast.expr:
    return node.value if isinstance(node, ast.Attribute) else node


def _named(key: ast.expr) -> object:
    return key.value if isinstance(key, ast.Constant) else "an entry"


def _is_made_anew(node: ast.Assign, entry: str, function: Function) -> bool:
    """Tell whether an entry is replaced by what is made of it, also through names, and twice is not once."""
    values, made = [node.value], {entry}
    for other in function.of(ast.Assign):
        if other is not node and any(text in ast.unparse(other.value) for text in made):
            bound = [ast.unparse(target) for target in targets(other) if isinstance(target, ast.Name)]
            made.update(bound)
            values += [other.value for name in bound if name in names(node.value)]
    is_made = any(text in ast.unparse(node.value) for text in made)
    is_other = any(isinstance(one, (ast.BinOp, ast.Call)) and last(called(one)) not in _SAME_AGAIN for one in values)
    return is_made and is_other


def _is_guarded(node: ast.AST, function: Function) -> bool:
    """Tell whether a change is made only where it was not made yet."""
    tests = (outer.test for outer in enclosing(node, function.up) if isinstance(outer, ast.If))
    return any(isinstance(child, (ast.NotIn, ast.In, ast.Is)) or last(called(child)) == "isinstance"
               for test in tests for child in ast.walk(test))  # fmt: skip


def _is_emptied(node: ast.AST) -> bool:
    value = getattr(node, "value", None)
    if not isinstance(node, (ast.Assign, ast.AnnAssign)):
        return False
    empty = isinstance(value, (ast.List, ast.Dict, ast.Tuple)) and not list(ast.iter_child_nodes(value))[:-1]
    return empty or (isinstance(value, ast.Constant) and value.value is None)


def _is_map(functions: list[Function], attribute: str) -> bool:
    """Tell whether these functions only set entries of an attribute, below its own level."""
    return all(write.kind == "keyed" for one in functions for write in one.writes if write.attribute == attribute)


def _dropped(functions: list[Function], attributes: set[str]) -> Iterator[tuple[Function, ast.AST, str]]:
    """Yield where these functions empty an attribute, or take an environment's observation out of it."""
    for function in functions:
        for node in function.of(ast.Assign, ast.AnnAssign, ast.Delete, ast.Call):
            dropped: list[str | None] = []
            if isinstance(node, (ast.Assign, ast.AnnAssign)) and _is_emptied(node):
                dropped = [self_attribute(target) for target in targets(node) if isinstance(target, ast.Attribute)]
            elif isinstance(node, ast.Delete):
                dropped = [self_attribute(target) for target in node.targets]
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in _DROPS:
                dropped = [self_attribute(node.func.value)] if isinstance(node.func.value, ast.Attribute) else []
            for attribute in dropped:
                if attribute in attributes and not _bounds(node, function):
                    yield function, node, attribute


def _bounds(node: ast.AST, function: Function) -> bool:
    """Tell whether something is dropped only to keep a length, or because it is no longer valid."""
    tests = (outer.test for outer in enclosing(node, function.up) if isinstance(outer, (ast.If, ast.While)))
    return any(isinstance(child, ast.Compare) for test in tests for child in ast.walk(test))
