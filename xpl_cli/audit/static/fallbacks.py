"""Find zeros that code uses in place of a missing value."""

from __future__ import annotations

import ast
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.static.syntax import always_raises, called, constant, dotted, last, names, texts

if TYPE_CHECKING:
    from xpl_cli.audit.static.function import Function

_MAKERS: Final = frozenset(("zeros", "zeros_like", "full", "ones", "new"))


@dataclass(frozen=True)
class ZeroFallback:
    """Zeros in place of a missing value.

    Attributes:
        node: the expression that creates them.
        missing: the missing value, as it is written.
        read: name of the dict that it was read from, with () if a function read it, "" if unknown.
        is_image: whether they have the shape or the type of an image.
        is_masked: whether the same branch sets a mask for the missing value.
    """

    function: Function
    node: ast.Call
    missing: str
    read: str
    is_image: bool
    is_masked: bool = False


def zero_fallbacks(function: Function) -> Iterator[ZeroFallback]:
    """Yield the zeros that a function uses if a look-up in a dict fails."""
    sources = _lookup_results(function)
    yield from _after_search(function, sources)
    for node in function.nodes:
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in {"get", "pop"}:
            if len(node.args) > 1 and (zeros := _zeros_call(node.args[1])) is not None:
                yield ZeroFallback(
                    function, zeros, ast.unparse(node.args[0]), _owner(node.func.value), _is_image(zeros)
                )
        elif isinstance(node, ast.If):
            yield from _branches(function, node.test, node.body, node.orelse, sources)
        elif isinstance(node, ast.IfExp):
            yield from _branches(function, node.test, [node.body], [node.orelse], sources)
        elif isinstance(node, ast.Try):
            for handler in node.handlers:
                if handler.type is not None and last(dotted(handler.type)) in {"KeyError", "Exception"}:
                    for zeros in _zeros_in_branch(handler.body):
                        read = next((_owner(child.value) for entry in node.body for child in ast.walk(entry)
                                     if isinstance(child, ast.Subscript) and _owner(child.value)), "")  # fmt: skip
                        yield ZeroFallback(
                            function, zeros, ast.unparse(node.body[0]).split("\n")[0], read, _is_image(zeros)
                        )


def _after_search(function: Function, sources: dict[str, str]) -> Iterator[ZeroFallback]:
    """Yield zeros that a function returns behind a branch which returns the value, if it is there."""
    for node in function.nodes:
        for block in (getattr(node, name, None) for name in ("body", "orelse")):
            for found, after in itertools.pairwise(block) if isinstance(block, list) else ():
                if not isinstance(found, ast.If) or found.orelse or not isinstance(after, ast.Return):
                    continue
                returns = any(isinstance(child, ast.Return) for child in ast.walk(found))
                zeros = _zeros_call(after.value) if after.value is not None and returns else None
                present = [one for one in _missing_tests(found.test, sources) if not one[2]]
                if zeros is not None and present:
                    yield ZeroFallback(function, zeros, *present[0][:2], _is_image(zeros))


def _branches(
    function: Function, test: ast.expr, body: Sequence[ast.AST], orelse: Sequence[ast.AST], sources: dict[str, str]
) -> Iterator[ZeroFallback]:
    """Yield zeros in the branch of a test that runs if a value is missing."""
    for what, read, is_missing in _missing_tests(test, sources):
        branch = body if is_missing else orelse
        is_masked = any(
            "mask" in identifier or "pad" in identifier for entry in branch for identifier in _identifiers(entry)
        )
        for zeros in _zeros_in_branch(branch):
            yield ZeroFallback(function, zeros, what, read, _is_image(zeros), is_masked)


def _identifiers(node: ast.AST) -> set[str]:
    attributes = {child.attr for child in ast.walk(node) if isinstance(child, ast.Attribute)}
    return {word.lower() for word in names(node) | texts(node) | attributes}


def _missing_tests(test: ast.expr, sources: dict[str, str]) -> Iterator[tuple[str, str, bool]]:
    """Yield the value that a test looks for, its dict, and whether the test is true if it is missing."""
    if isinstance(test, ast.BoolOp):
        for value in test.values:
            yield from _missing_tests(value, sources)
    elif isinstance(test, ast.Compare) and len(test.ops) == 1:
        operator, left, right = test.ops[0], test.left, test.comparators[0]
        if isinstance(operator, (ast.Is, ast.IsNot)) and constant(right) is None and isinstance(left, ast.Name):
            if left.id in sources:
                yield left.id, sources[left.id], isinstance(operator, ast.Is)
        elif isinstance(operator, (ast.In, ast.NotIn)) and _owner(right):
            yield ast.unparse(left), _owner(right), isinstance(operator, ast.NotIn)


def _lookup_results(function: Function) -> dict[str, str]:
    """Return the names assigned from a look-up, directly or by a function, with the dict they come from."""
    sources: dict[str, str] = {}
    for node in function.nodes:
        value = getattr(node, "value", None)
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and isinstance(value, ast.expr):
            read = _map_of(value)
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets if read else []:
                if isinstance(target, ast.Name):
                    sources.setdefault(target.id, read)
    return sources


def _map_of(value: ast.expr) -> str:
    if isinstance(value, ast.Call) and isinstance(value.func, ast.Attribute) and value.func.attr in {"get", "pop"}:
        return _owner(value.func.value)
    if isinstance(value, ast.Call):  # extract(observation, key): a function that may return nothing
        return next((f"{argument.id}()" for argument in value.args if isinstance(argument, ast.Name)), "")
    if isinstance(value, ast.IfExp):
        return _map_of(value.body) or _map_of(value.orelse)
    return ""


def _owner(node: ast.expr) -> str:
    """Return a map as it is written, with its constant keys as further parts: `obs.state` for `obs["state"]`."""
    if isinstance(node, ast.Subscript) and isinstance(constant(node.slice), str):
        outer = _owner(node.value)
        return outer and f"{outer}.{constant(node.slice)}"
    return dotted(node)


def _zeros_in_branch(body: Sequence[ast.AST]) -> Iterator[ast.Call]:
    """Yield the zeros that a branch returns or assigns."""
    if any(isinstance(entry, ast.stmt) for entry in body) and always_raises(
        [e for e in body if isinstance(e, ast.stmt)]
    ):
        return
    for entry in body:
        value = entry if isinstance(entry, ast.expr) else getattr(entry, "value", None)
        if isinstance(entry, (ast.Return, ast.Assign, ast.AnnAssign, ast.expr)) and isinstance(value, ast.expr):
            zeros = _zeros_call(value)
            if zeros is not None:
                yield zeros


def _zeros_call(value: ast.expr) -> ast.Call | None:
    """Return the call that creates zeros, if a value is only that, possibly converted."""
    while isinstance(value, ast.Call):
        name = called(value)
        if last(name) in _MAKERS and name.partition(".")[0] in {"np", "numpy", "torch", "jnp", "Image"}:
            is_zero = last(name) in {"zeros", "zeros_like", "new"} or (
                last(name) == "full" and bool(value.args) and constant(value.args[-1]) == 0
            )
            return value if is_zero else None
        if isinstance(value.func, ast.Attribute) and isinstance(value.func.value, ast.Call):
            value = value.func.value  # np.zeros(...).astype(...)
        elif len(value.args) >= 1 and isinstance(value.args[0], ast.Call):
            value = value.args[0]  # torch.from_numpy(np.zeros(...))
        else:
            return None
    return None


def _is_image(zeros: ast.Call) -> bool:
    """Return whether zeros have the shape (H, W, 3) or (3, H, W), or are bytes."""
    if called(zeros).startswith("Image."):
        return True
    shape = zeros.args[0] if zeros.args else None
    sizes = shape.elts if isinstance(shape, (ast.Tuple, ast.List)) else []
    has_channels = len(sizes) >= 3 and 3 in (constant(sizes[-1]), constant(sizes[-3]))
    is_bytes = any(
        "uint8" in ast.unparse(value) for value in (*zeros.args[1:], *(entry.value for entry in zeros.keywords))
    )
    return has_channels or (is_bytes and (len(sizes) >= 2 or bool(shape is not None and names(shape))))
