"""Leaves out parts of an adapter's own code, one by one: a mistake behind `encode` is in no input and no block.

Functions of the adapter's modules get code objects in which each part can be switched: a call gives its first argument,
its object, or has one keyword less; a sum of texts or numbers is one of its terms; a slice is the whole; a condition
holds always or never; a statement is not run. Only parts that run between an observation and the actions count.
"""

from __future__ import annotations

import ast
import contextlib
import inspect
import os
import sys
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from types import CodeType, FunctionType, ModuleType
from typing import TYPE_CHECKING, Any, Callable

import numpy as np

from xpl.catalogue.walk import NoEffectError, channel_axis, is_vector, leaves

if TYPE_CHECKING:
    from pathlib import Path

_ON, _WITHOUT, _SEEN = "_xpl_is_left_out", "_xpl_without", "_xpl_seen"
_LOADING = frozenset(("load", "__init__", "__del__"))
"""Functions that run before the first observation."""
_PLAIN = frozenset(
    ("len", "range", "int", "float", "str", "bool", "isinstance", "getattr", "enumerate", "zip", "print")
)
"""Functions that are not left out: they convert nothing."""
_VIEWS = frozenset(("items", "keys", "values"))
_MOST = 128
"""Most parts."""
_TERMS = 4
_WORDS = 70
_NEAR = 1e-5

Replacement = tuple[ast.expr, str]
"""An expression in place of another one, and the text of what is left out."""


@dataclass(frozen=True)
class _CodePart:
    """A part of the code.

    Attributes:
        where: file and line.
        text: what is left out.
    """

    where: str
    text: str

    @property
    def words(self) -> str:
        return f"{self.where} without {self.text}"


class CodeParts:
    """The parts of an adapter's code.

    Args:
        folder: of the adapter, whose modules are imported.
        replay: answers the calls of an episode; what runs meanwhile counts.
    """

    def __init__(self, folder: Path, replay: Callable[[], object]) -> None:
        self._parts: list[_CodePart] = []
        self._active: int | None = None
        self._before: dict[int, Any] | None = None
        self._after: Any = None
        self._conventions: dict[int, str] = {}
        own = os.path.realpath(folder) + os.sep
        for module in list(sys.modules.values()):
            path = getattr(module, "__file__", None)
            if path and os.path.realpath(path).startswith(own) and len(self._parts) < _MOST:
                self._prepare(module, path)
        self._seen: dict[int, Any] = {}
        self._before = self._seen
        replay()
        self._before = None
        self.numbers = [number for number in sorted(self._seen) if number < _MOST]

    @contextlib.contextmanager
    def without(self, place: int) -> Iterator[None]:
        """Leave out a part within a `with` block.

        Raises:
            NoEffectError: there is no such part, or it changes nothing.
        """
        if place >= len(self.numbers):
            raise NoEffectError("no such part")
        self._active, self._after = self.numbers[place], None
        try:
            yield
        finally:
            self._active = None

    def words(self, place: int) -> str:
        """Return file, line and text of a part."""
        return self._parts[self.numbers[place]].words

    def convention(self, place: int) -> str:
        """Return the convention of a part that was left out, by what it did to its value; "" if that does not tell."""
        number = self.numbers[place]
        if number not in self._conventions:  # with the first calls, with which values were seen
            before, told = self._seen.get(number), _by_text(self._parts[number].text)
            found = told if _is_number(before) else convention_of_change(before, self._after)
            self._conventions[number] = found or told
        return self._conventions[number]

    # -- called by the adapter's code ----------------------------------------------------------------------------------

    def _is_left_out(self, number: int) -> bool:
        return number == self._active

    def _without(self, number: int, value: Any) -> Any:
        if self._after is None:
            self._after = _kept(value)
            before = self._seen.get(number)
            if number in self._seen and _kind(before) != _kind(self._after):  # of which a model may make anything
                raise NoEffectError("it is something else")
            is_array = isinstance(before, np.ndarray) and isinstance(self._after, np.ndarray)
            if is_array and _are_equal(
                before, self._after
            ):  # a text or a condition may be the same only the first time
                raise NoEffectError("it changes nothing")
        return value

    def _note(self, numbers: Sequence[int], value: Any) -> Any:
        if self._before is not None:
            kept = _kept(value)
            for number in numbers:
                self._before.setdefault(number, kept)
        return value

    # -- code ----------------------------------------------------------------------------------------------------------

    def _prepare(self, module: ModuleType, path: str) -> None:
        """Exchange the code of a module's functions."""
        try:
            with open(path, encoding="utf-8") as file:  # noqa: PTH123 - as elsewhere here
                tree = ast.parse(file.read(), path)
        except (OSError, ValueError, SyntaxError):
            return
        made = ast.fix_missing_locations(_Switches(self._parts, os.path.basename(path)).visit(tree))  # noqa: PTH119
        codes = dict(_codes(compile(made, path, "exec", dont_inherit=True)))
        vars(module).update({_ON: self._is_left_out, _WITHOUT: self._without, _SEEN: self._note})
        for function in _functions(module):
            old = function.__code__
            new = codes.get((old.co_name, old.co_firstlineno))
            if new is not None and new.co_freevars == old.co_freevars:
                function.__code__ = new


def _functions(module: ModuleType) -> Iterator[FunctionType]:
    """Yield the functions and methods that a module defines."""
    for holder in (module, *(one for one in vars(module).values() if inspect.isclass(one))):
        if getattr(holder, "__module__", module.__name__) != module.__name__:
            continue
        for value in list(vars(holder).values()):
            found = inspect.unwrap(getattr(value, "__func__", getattr(value, "fget", value)))
            if isinstance(found, FunctionType) and found.__module__ == module.__name__:
                yield found


def _codes(code: CodeType) -> Iterator[tuple[tuple[str, int], CodeType]]:
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield (inner.co_name, inner.co_firstlineno), inner
            yield from _codes(inner)


class _Switches(ast.NodeTransformer):
    """Puts a switch at each part of a module's functions."""

    def __init__(self, parts: list[_CodePart], file: str) -> None:
        self._parts, self._file = parts, file
        self._modules: set[str] = set()
        self._is_inside = False

    def visit_Import(self, node: ast.Import) -> ast.AST:
        self._modules |= {(one.asname or one.name).partition(".")[0] for one in node.names}
        return node

    def visit_ImportFrom(self, node: ast.ImportFrom) -> ast.AST:
        self._modules |= {one.asname or one.name for one in node.names}
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        if node.name in _LOADING:
            return node
        was, self._is_inside = self._is_inside, True
        node.body = [one for statement in node.body for one in _listed(self.visit(statement))]
        self._is_inside = was
        return node

    def visit_While(self, node: ast.While) -> ast.AST:
        return node  # without a part it may not end

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        if node.value is not None:
            node.value = self.visit(node.value)
        return node

    def visit_If(self, node: ast.If) -> ast.AST:
        text = _short(node.test)
        node = self._visited(node)
        if self._is_inside:
            choices: list[Replacement] = [
                (ast.Constant(True), f"the condition {text}"),  # noqa: FBT003 - a node's value
                (ast.Constant(False), f"the branch of {text}"),  # noqa: FBT003
            ]
            node.test = self._switched(node.test, choices, node.test)
        return node

    def visit_Assign(self, node: ast.Assign) -> ast.AST:
        text = _short(node)
        is_again = all(
            isinstance(one, (ast.Subscript, ast.Attribute))
            or (isinstance(one, ast.Name) and any(_is_name(inner, one.id) for inner in ast.walk(node.value)))
            for one in node.targets
        )
        node.value = self.visit(node.value)
        return self._optional(node, text) if is_again else node

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        text = _short(node)
        node.value = self.visit(node.value)
        return self._optional(node, text)

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        if not isinstance(node.value, ast.Call):
            return node
        text = _short(node)
        node.value = self._visited(node.value)
        return self._optional(node, text)

    def visit_Call(self, node: ast.Call) -> ast.AST:
        return self._with_choices(node, list(self._of_call(node)))

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        fields = [one for one in node.values if isinstance(one, ast.FormattedValue)]
        choices = [(one.value, f"the text around {_short(one.value)}") for one in fields[:_TERMS]]
        return self._with_choices(node, choices, inner=False)

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        terms = [one for one in _terms(node) if not isinstance(one, ast.Constant)][:_TERMS]
        text = _short(node)
        return self._with_choices(node, [(one, f"{text}, but {_short(one)}") for one in terms])

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        is_sign = isinstance(node.op, ast.USub) and not isinstance(node.operand, ast.Constant)
        return self._with_choices(node, [(node.operand, f"the sign of {_short(node.operand)}")] if is_sign else [])

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        slices = [one for one in ast.walk(node.slice) if isinstance(one, (ast.Slice, ast.List))]
        is_read = isinstance(node.ctx, ast.Load)
        index = ast.unparse(node)[len(ast.unparse(node.value)) :]
        return self._with_choices(node, [(node.value, index)] if slices and is_read else [])

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        text = _short(node)
        return self._with_choices(node, [(one, f"{text}, but {_short(one)}") for one in (node.body, node.orelse)])

    def _of_call(self, node: ast.Call) -> Iterator[Replacement]:
        text = _short(node)
        first = node.args[0] if node.args and not isinstance(node.args[0], ast.Starred) else None
        if first is not None and not (isinstance(node.func, ast.Name) and node.func.id in _PLAIN):
            yield first, text
        is_method = isinstance(node.func, ast.Attribute) and not self._is_module(node.func.value)
        if is_method and node.func.attr not in _VIEWS:  # type: ignore[attr-defined]
            yield node.func.value, text  # type: ignore[attr-defined]
        for number, keyword in enumerate(node.keywords):
            if keyword.arg is not None:
                rest = [*node.keywords[:number], *node.keywords[number + 1 :]]
                yield ast.Call(node.func, node.args, rest), f"{keyword.arg}={_short(keyword.value)}"

    def _is_module(self, node: ast.expr) -> bool:
        while isinstance(node, ast.Attribute):
            node = node.value
        return isinstance(node, ast.Name) and node.id in {*self._modules, "self"}

    def _with_choices(self, node: ast.expr, choices: Sequence[Replacement], *, inner: bool = True) -> ast.expr:
        choices = [(deepcopy(one), text) for one, text in choices]  # without the switches inside
        made = self._visited(node) if inner else node
        return self._switched(made, choices, node) if self._is_inside else made

    def _visited(self, node: Any) -> Any:
        return self.generic_visit(node)

    def _switched(self, node: ast.expr, choices: Sequence[Replacement], at: ast.expr) -> ast.expr:
        numbers = [self._add(at, text) for _, text in choices]
        if not numbers:
            return node
        result: ast.expr = _call(_SEEN, ast.Tuple([ast.Constant(one) for one in numbers], ast.Load()), node)
        for number, (other, _) in zip(numbers, choices):
            without = _call(_WITHOUT, ast.Constant(number), other)
            result = ast.IfExp(_call(_ON, ast.Constant(number)), without, result)
        return ast.copy_location(result, at)

    def _optional(self, node: Any, text: str) -> ast.stmt:
        """Return a statement that can be left out."""
        if not self._is_inside:
            return node  # type: ignore[no-any-return]
        number = self._add(node, text)
        seen = ast.Expr(_call(_SEEN, ast.Tuple([ast.Constant(number)], ast.Load()), ast.Constant(None)))
        test = ast.UnaryOp(ast.Not(), _call(_ON, ast.Constant(number)))
        return ast.copy_location(ast.If(test, [seen, node], []), node)

    def _add(self, node: Any, text: str) -> int:
        self._parts.append(_CodePart(f"{self._file}:{node.lineno}", text))
        return len(self._parts) - 1


def _listed(node: Any) -> list[Any]:
    return list(node) if isinstance(node, list) else [node]


def _call(name: str, *arguments: ast.expr) -> ast.expr:
    return ast.Call(ast.Name(name, ast.Load()), list(arguments), [])


def _short(node: ast.AST) -> str:
    text = " ".join(ast.unparse(node).split())
    return text if len(text) <= _WORDS else f"{text[: _WORDS - 3]}..."


def _is_name(node: ast.AST, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


def _terms(node: ast.expr) -> Iterator[ast.expr]:
    """Yield the terms of a sum or product."""
    if isinstance(node, ast.BinOp):
        yield from _terms(node.left)
        yield from _terms(node.right)
    else:
        yield node


# -- what a part does --------------------------------------------------------------------------------------------------


def _kept(value: Any) -> Any:
    """Return a copy of a text, array, tensor or image, or of a list of them; otherwise the value."""
    if isinstance(value, (list, tuple)):
        return [_kept(one) for one in value]
    if hasattr(value, "getbands"):  # an image of PIL
        return np.array(value)
    if isinstance(value, (str, dict)) or np.isscalar(value):
        return value
    found = list(leaves(value))
    return found[0].copy() if len(found) == 1 and not isinstance(found[0], str) else value


def _kind(value: Any) -> str:
    """Return what a kept value is: an image, an array of as many axes, or its type."""
    if isinstance(value, np.ndarray):
        return f"{value.ndim} axes" if channel_axis(value) is None else "image"
    return type(value).__name__


def _are_equal(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return one.shape == other.shape and bool((one == other).all())
    if isinstance(one, list):
        pairs = list(zip(one, other))
        return len(one) == len(other) and all(type(a) is type(b) and _are_equal(a, b) for a, b in pairs)
    return isinstance(one, (str, int, float)) and bool(one == other)


def convention_of_change(before: Any, after: Any) -> str:
    """Return the convention in which two values of one expression differ; "" if they do not tell."""
    if isinstance(before, str) and isinstance(after, str):
        return "instruction"
    if isinstance(before, list) and isinstance(after, list):
        return _of_lists(before, after)
    if not isinstance(before, np.ndarray) or not isinstance(after, np.ndarray):
        return ""
    return _of_images(before, after) if channel_axis(before) is not None else _of_numbers(before, after)


def _of_lists(before: Sequence[Any], after: Sequence[Any]) -> str:
    pairs = [(one, other) for one, other in zip(before, after) if not _are_equal([one], [other])]
    is_moved = len(before) == len(after) and all(any(_are_equal([one], [at]) for at in after) for one, _ in pairs)
    if len(pairs) > 1 and is_moved:
        is_image = all(isinstance(one, np.ndarray) and channel_axis(one) is not None for one, _ in pairs)
        return "camera" if is_image else "joint_order"
    return convention_of_change(*pairs[0]) if pairs else ""


def _of_images(before: np.ndarray, after: np.ndarray) -> str:
    axis = channel_axis(before)
    if before.shape != after.shape:
        is_turned = sorted(before.shape) == sorted(after.shape)
        return "image_orientation" if is_turned else "image_size"
    rows, columns = (-3, -2) if axis == -1 else (-2, -1)
    if _is_near(np.flip(after, axis or -1), before):
        return "image_channels"
    if any(_is_near(np.flip(after, axes), before) for axes in ((rows,), (columns,), (rows, columns))):
        return "image_orientation"
    one, other = before.astype(np.float64).ravel(), after.astype(np.float64).ravel()
    if np.ptp(other) > 0:
        slope, offset = np.polyfit(other, one, 1)
        if np.abs(slope * other + offset - one).max() <= 0.01 * (np.ptp(one) or 1.0):
            return "image_range"
    return "image_filter"


def _is_number(value: Any) -> bool:
    """Return whether a value is an array of numbers of one kind, of which only a name may tell what they are."""
    return isinstance(value, np.ndarray) and value.shape[-1:] in ((1,), (2,)) and channel_axis(value) is None


def _of_numbers(before: np.ndarray, after: np.ndarray) -> str:
    if before.shape != after.shape:
        is_longer = before.ndim == after.ndim > 1 and before.shape[-1] == after.shape[-1]
        return "chunk" if is_longer else ""
    if not is_vector(before):
        return ""
    if np.allclose(np.sort(before, axis=-1), np.sort(after, axis=-1), rtol=_NEAR):
        return "joint_order"
    changed = ~np.isclose(before, after, rtol=_NEAR).reshape(-1, before.shape[-1]).all(0)
    last = changed.size - 1
    return "gripper" if changed[last] and not changed[: last // 2].any() else "normalization"


def _is_near(one: np.ndarray, other: np.ndarray) -> bool:
    return one.shape == other.shape and np.allclose(one, other, rtol=_NEAR)


_KEYWORDS = (("noise", "sampling"), ("seed", "sampling"), ("generator", "sampling"), ("sample", "sampling"))
_NAMES = (("gripper", "gripper"), ("finger", "gripper"))


def _by_text(text: str) -> str:
    """Return the convention that the code's own names tell: of a keyword, or anywhere in it."""
    told = [convention for word, convention in _KEYWORDS if text.startswith(word)]
    told += [convention for word, convention in _NAMES if word in text.lower()]
    return told[0] if told else ""
