"""What an expression of the adapter is under its own deploy.yml: constants, settings, and little arithmetic on them.

Nothing is executed. What cannot be told is `UNKNOWN`; the smaller of something known and something unknown is taken to
be what is known, because that is how adapters cap a chunk by what the model returns.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl_cli.adopt.facts import Evidence
from xpl_cli.audit.static.manifests import key_line
from xpl_cli.audit.static.syntax import called, constant, key_read, last, self_attribute, targets

if TYPE_CHECKING:
    from xpl_cli.audit.static.adapter import Adapter
    from xpl_cli.audit.static.function import Function
    from xpl_cli.audit.static.source import Source
    from xpl_cli.audit.static.syntax import KeyRead

UNKNOWN: Final = object()
_DEEPEST: Final = 12
_COMPARISONS: Final[dict[type[ast.cmpop], Callable[[Any, Any], Any]]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda one, other: one in other,
    ast.NotIn: lambda one, other: one not in other,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
_ARITHMETIC: Final[dict[type[ast.operator], Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.FloorDiv: operator.floordiv,
}
_CONVERSIONS: Final[dict[str, Callable[[Any], Any]]] = {"int": int, "float": float, "str": str, "bool": bool}


@dataclass
class Values:
    """Values of one adapter's expressions.

    Attributes:
        trail: settings and constants that the last `of` went through, as evidence.
        keys: names of these settings and constants.
    """

    source: Source
    adapter: Adapter
    trail: list[Evidence] = field(default_factory=list)
    keys: list[str] = field(default_factory=list)

    def of(self, expression: ast.expr, function: Function) -> Any:
        """Return the value of an expression in a function, or UNKNOWN."""
        self.trail, self.keys = [], []
        return self._of(expression, function, 0)

    def setting(self, read: KeyRead, function: Function, depth: int = 0) -> Any:
        """Return what a read of the configuration gives: deploy.yml's value, or the default in the code."""
        given = self.source.deploy.get(read.key)
        if given is not None:
            name = sdk.File.DEPLOY_YML
            self._note(read.key, Evidence(name, key_line(self.source, name, read.key), f"{read.key}: {given}"))
            return given
        if read.required or read.default is None:
            return None
        default = self._of(read.default, function, depth + 1)
        if default is not UNKNOWN:
            what = f"{read.key} is {default!r} by default"
            self._note(read.key, Evidence(function.file, read.node.lineno, what))
        return default

    @cached_property
    def reads(self) -> dict[int, KeyRead]:
        """Every read of the configuration, by its node's identity."""
        return {id(setting.read.node): setting.read for setting in self.adapter.settings}

    @cached_property
    def attributes(self) -> dict[str, list[tuple[Function, ast.expr]]]:
        """What each attribute of the model is assigned, and where."""
        found: dict[str, list[tuple[Function, ast.expr]]] = {}
        for function in self.adapter.reach(*self.adapter.methods):
            assignments: list[ast.Assign | ast.AnnAssign] = [*function.of(ast.Assign), *function.of(ast.AnnAssign)]
            for node in assignments:
                name = next((self_attribute(target) for target in targets(node)), None)
                if name is not None and node.value is not None and isinstance(targets(node)[0], ast.Attribute):
                    found.setdefault(name, []).append((function, node.value))
        return found

    def module_constant(self, file: str, name: str) -> ast.Assign | ast.AnnAssign | None:
        """Return the statement that gives a name its value at the top of a file; None if there are several or none."""
        body = self.source.tree(file).body
        assignments = (node for node in body if isinstance(node, (ast.Assign, ast.AnnAssign)))
        named = [node for node in assignments if any(_is_name(target, name) for target in targets(node))]
        return named[0] if len(named) == 1 else None

    def _note(self, key: str, evidence: Evidence) -> None:
        if evidence not in self.trail:
            self.trail.append(evidence)
        self.keys.append(key)

    def _of(self, node: ast.expr, function: Function, depth: int) -> Any:
        if depth > _DEEPEST:
            return UNKNOWN
        deeper = depth + 1
        value: Any = UNKNOWN
        if (plain := constant(node)) is not ...:
            value = plain
        elif (read := key_read(node)) is not None:
            value = self.setting(read, function, deeper) if id(node) in self.reads else UNKNOWN
        elif isinstance(node, ast.Name):
            value = self._name(node.id, function, deeper)
        elif isinstance(node, ast.Attribute):
            attribute = self_attribute(node)
            value = self._attribute(attribute, deeper) if attribute and isinstance(node.value, ast.Name) else UNKNOWN
        elif isinstance(node, (ast.Tuple, ast.List, ast.Set)):
            parts = [self._of(part, function, deeper) for part in node.elts]
            value = UNKNOWN if UNKNOWN in parts else tuple(parts)
        elif isinstance(node, ast.Call):
            value = self._call(node, function, deeper)
        else:
            value = self._combined(node, function, deeper)
        return value

    def _name(self, name: str, function: Function, depth: int) -> Any:
        assigned = [node for node in function.of(ast.Assign) if any(_is_name(part, name) for part in targets(node))]
        if assigned:
            return self._one({self._hashable(self._of(node.value, function, depth)) for node in assigned})
        module = None if self._is_parameter(name, function) else self.module_constant(function.file, name)
        if module is None or module.value is None:
            return UNKNOWN
        value = self._of(module.value, function, depth)
        if value is not UNKNOWN:
            self._note(name, Evidence(function.file, module.lineno, f"{name} = {value!r}"))
        return value

    @staticmethod
    def _is_parameter(name: str, function: Function) -> bool:
        arguments = function.node.args
        return any(part.arg == name for part in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs))

    def _attribute(self, name: str, depth: int) -> Any:
        of_class = [
            node.value
            for node in self.adapter.node.body
            if isinstance(node, ast.Assign) and any(_is_name(part, name) for part in targets(node))
        ]
        if of_class and name not in self.attributes:
            return constant(of_class[-1]) if constant(of_class[-1]) is not ... else UNKNOWN
        places = self.attributes.get(name, [])
        return self._one({self._hashable(self._of(value, function, depth)) for function, value in places})

    @staticmethod
    def _hashable(value: Any) -> Any:
        try:
            hash(value)
        except TypeError:
            return tuple(value) if isinstance(value, list) else UNKNOWN
        return value

    @staticmethod
    def _one(values: set[Any]) -> Any:
        """Return the one value that is known; None, which adapters write before they know, counts only alone."""
        known = values - {UNKNOWN}
        known = known - {None} or known
        return next(iter(known)) if len(known) == 1 else UNKNOWN

    def _call(self, node: ast.Call, function: Function, depth: int) -> Any:
        name = last(called(node))
        given = [self._of(part, function, depth) for part in node.args]
        if node.keywords or not given:
            return UNKNOWN
        if name in {"min", "max"}:
            known = [value for value in given if isinstance(value, (int, float))]
            whole = len(known) == len(given)
            return (min if name == "min" else max)(known) if known and (whole or name == "min") else UNKNOWN
        if UNKNOWN in given or (len(given) > 1 and "bool" not in name):
            return UNKNOWN
        if name.endswith("bool"):  # an adapter's own reader of flags
            return given[0] if isinstance(given[0], bool) else UNKNOWN
        convert = _CONVERSIONS.get(name)
        try:
            return convert(given[0]) if convert and given[0] is not None else UNKNOWN
        except (TypeError, ValueError, ArithmeticError):
            return UNKNOWN

    def _combined(self, node: ast.expr, function: Function, depth: int) -> Any:
        if isinstance(node, ast.BoolOp):
            return self._either(node, function, depth)
        if isinstance(node, ast.IfExp):
            test = self._of(node.test, function, depth)
            chosen = node.body if test else node.orelse
            return UNKNOWN if test is UNKNOWN else self._of(chosen, function, depth)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            value = self._of(node.operand, function, depth)
            return UNKNOWN if value is UNKNOWN else not value
        if isinstance(node, ast.Compare) and len(node.ops) == 1:
            return self._pair(node.left, _COMPARISONS.get(type(node.ops[0])), node.comparators[0], function, depth)
        if isinstance(node, ast.BinOp):
            value = self._pair(node.left, _ARITHMETIC.get(type(node.op)), node.right, function, depth)
            return value if isinstance(value, (int, float)) else UNKNOWN
        return UNKNOWN

    def _pair(
        self, left: ast.expr, combine: Callable[[Any, Any], Any] | None, right: ast.expr, function: Function, depth: int
    ) -> Any:
        one, other = self._of(left, function, depth), self._of(right, function, depth)
        if combine is None or one is UNKNOWN or other is UNKNOWN:
            return UNKNOWN
        if combine is operator.mul and not (isinstance(one, (int, float)) and isinstance(other, (int, float))):
            return UNKNOWN  # a text times a number may be larger than any memory
        try:
            return combine(one, other)
        except (TypeError, ValueError, ArithmeticError):
            return UNKNOWN

    def _either(self, node: ast.BoolOp, function: Function, depth: int) -> Any:
        decides = isinstance(node.op, ast.Or)
        value: Any = UNKNOWN
        for part in node.values:
            value = self._of(part, function, depth)
            if value is UNKNOWN or bool(value) is decides:
                return value
        return value


def _is_name(node: ast.expr, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name
