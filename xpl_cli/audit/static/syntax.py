"""Queries on Python syntax trees. Names are compared as they are written: nothing is imported."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

FunctionNode = ast.FunctionDef | ast.AsyncFunctionDef
SCOPES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Lambda)
LOOPS = (ast.For, ast.AsyncFor, ast.While, ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)


@dataclass(frozen=True)
class KeyRead:
    """`owner[key]`, `owner.get(key)` or `owner.get(key, default)` with a constant key."""

    node: ast.expr
    owner: ast.expr
    key: str
    default: ast.expr | None
    required: bool


def dotted(node: ast.AST) -> str:
    """Return `a.b.c` for a chain of names, and "" for everything else."""
    parts: list[str] = []
    while isinstance(node, ast.Attribute):
        parts.append(node.attr)
        node = node.value
    if not isinstance(node, ast.Name):
        return ""
    return ".".join([node.id, *reversed(parts)])


def called(node: ast.AST) -> str:
    """Return the dotted name of the function that a call calls; for `f(x).g()` only `g`, "" if it is no call."""
    if not isinstance(node, ast.Call):
        return ""
    return dotted(node.func) or (node.func.attr if isinstance(node.func, ast.Attribute) else "")


def last(name: str) -> str:
    """Return the last part of a dotted name."""
    return name.rpartition(".")[2]


def children(node: ast.AST) -> list[ast.AST]:
    """Return the children of a node, in source order; twice as fast as `ast.iter_child_nodes`."""
    nodes: list[ast.AST] = []
    for name in node._fields:
        value = getattr(node, name, None)
        if isinstance(value, ast.AST):
            nodes.append(value)
        elif isinstance(value, list):
            nodes += [entry for entry in value if isinstance(entry, ast.AST)]
    return nodes


def descendants(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the descendants of `node` in source order, without entering nested functions and classes."""
    for child in children(node):
        yield child
        if not isinstance(child, SCOPES):
            yield from descendants(child)


def parents(node: ast.AST) -> dict[ast.AST, ast.AST]:
    """Return the parent of every node below `node`."""
    return {child: parent for parent in ast.walk(node) for child in children(parent)}


def enclosing(node: ast.AST, up: dict[ast.AST, ast.AST]) -> Iterator[ast.AST]:
    """Yield the ancestors of a node, nearest first."""
    while node in up:
        node = up[node]
        yield node


def names(node: ast.AST) -> set[str]:
    """Return every plain name that is read or written below `node`."""
    return {child.id for child in ast.walk(node) if isinstance(child, ast.Name)}


def texts(node: ast.AST) -> set[str]:
    """Return every string constant below `node`, parts of f-strings included."""
    return {child.value for child in ast.walk(node) if isinstance(child, ast.Constant) and isinstance(child.value, str)}


def constant(node: ast.AST | None) -> object:
    """Return the value of a constant, with its sign; Ellipsis, which no rule needs, for everything else."""
    if isinstance(node, ast.Constant):
        return node.value
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and isinstance(node.operand, ast.Constant):
        value = node.operand.value
        return -value if isinstance(value, (int, float)) else ...
    return ...


def key_read(node: ast.AST) -> KeyRead | None:
    """Return the constant key that a node reads from a dict, or None."""
    if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Load):
        key = constant(node.slice)
        return KeyRead(node, node.value, key, None, required=True) if isinstance(key, str) else None
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in {"get", "pop"}:
        key = constant(node.args[0]) if node.args else ...
        if isinstance(key, str):
            return KeyRead(node, node.func.value, key, node.args[1] if len(node.args) > 1 else None, required=False)
    return None


def self_attribute(node: ast.AST) -> str | None:
    """Return `x` for `self.x` and anything inside it: `self.x[0].y`, `self.x.append`."""
    while isinstance(node, (ast.Attribute, ast.Subscript, ast.Starred)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "self":
            return node.attr
        node = node.value
    return None


def targets(node: ast.AST) -> list[ast.expr]:
    """Return the targets of an assignment, with tuples unpacked."""
    assigned_to: list[ast.expr] = []
    if isinstance(node, ast.Assign):
        assigned_to = list(node.targets)
    elif isinstance(node, (ast.AnnAssign, ast.AugAssign, ast.For, ast.AsyncFor, ast.NamedExpr)):
        assigned_to = [node.target]
    elif isinstance(node, ast.withitem) and node.optional_vars is not None:
        assigned_to = [node.optional_vars]
    flat: list[ast.expr] = []
    for target in assigned_to:
        flat.extend(target.elts if isinstance(target, (ast.Tuple, ast.List)) else [target])
    return flat


def parameters(function: FunctionNode) -> list[str]:
    """Return the names of a method's positional parameters, without self."""
    names_of_arguments = [argument.arg for argument in (*function.args.posonlyargs, *function.args.args)]
    return names_of_arguments[1:] if names_of_arguments[:1] in (["self"], ["cls"]) else names_of_arguments


def always_raises(body: list[ast.stmt]) -> bool:
    """Return whether a block always raises."""
    return any(isinstance(statement, ast.Raise) for statement in body)


def leaves(body: list[ast.stmt]) -> bool:
    """Return whether a block ends by leaving its loop or function."""
    return bool(body) and isinstance(body[-1], (ast.Return, ast.Raise, ast.Break, ast.Continue))


def may_skip(statement: ast.stmt) -> bool:
    """Return whether a statement may skip the following ones, other than by an error."""
    return isinstance(statement, ast.If) and leaves(statement.body) and not isinstance(statement.body[-1], ast.Raise)


def is_broad(handler: ast.ExceptHandler) -> bool:
    """Return whether a handler catches everything: bare, Exception or BaseException."""
    if handler.type is None:
        return True
    caught = handler.type.elts if isinstance(handler.type, ast.Tuple) else [handler.type]
    return any(last(dotted(entry)) in {"Exception", "BaseException"} for entry in caught)


def is_conditional(node: ast.AST, function: ast.AST, up: dict[ast.AST, ast.AST]) -> bool:
    """Return whether a statement of a function runs conditionally: inside a branch, or after one that may return."""
    inner = node
    for ancestor in enclosing(node, up):
        if isinstance(ancestor, (ast.If, ast.IfExp, ast.ExceptHandler, ast.While, ast.Match, ast.BoolOp)):
            return True
        for block in ("body", "orelse", "finalbody"):
            statements = getattr(ancestor, block, None)
            if isinstance(statements, list) and inner in statements:
                before = statements[: statements.index(inner)]
                if any(map(may_skip, before)):
                    return True
        if ancestor is function:
            return False
        inner = ancestor
    return False


def assigned(nodes: Iterable[ast.AST]) -> dict[str, ast.expr]:
    """Return the expression that each local name is assigned, the last one if there are several."""
    return {
        target.id: node.value
        for node in nodes
        if isinstance(node, ast.Assign)
        for target in targets(node)
        if isinstance(target, ast.Name)
    }
