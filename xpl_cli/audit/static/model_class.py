"""The class `Model` of an adapter: its methods, the functions that they reach, and the configuration that they read."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl_cli.audit.rules.model import NotApplicable, NotRun
from xpl_cli.audit.static.episode_state import is_reported
from xpl_cli.audit.static.function import Function, Symbols
from xpl_cli.audit.static.syntax import (
    KeyRead,
    called,
    dotted,
    key_read,
    last,
    parameters,
    self_attribute,
    targets,
)

if TYPE_CHECKING:
    from xpl_cli.audit.static.source import Source

UPDATE, UPDATE_BATCH, ACT, ACT_BATCH, RESET = sdk.CONTRACT_METHODS
LOADING: Final = ("__init__", "load")
OBSERVING: Final = (UPDATE, UPDATE_BATCH, "encode")
ACTING: Final = (ACT, ACT_BATCH, "predict", "decode")
RESETTING: Final = (RESET, "reset_env")

_ECOSYSTEM: Final = "XPolicyLab."
"""Helpers of this package read keys of the standard, and keys that the adapter passes to them."""
_SDK_CLASS, _TEMPLATE = "Policy", "ModelTemplate"
_TEMPLATE_GIVES: Final = ("__init__", RESET)
_HARMLESS: Final = frozenset(("dict", "copy", "deepcopy", "isinstance", "len", "str", "repr", "print", "bool", "get"))
"""Calls that get a configuration but read no relevant key of it."""


@dataclass(frozen=True)
class ConfigRead:
    """One expression that reads a key of the configuration."""

    function: Function
    read: KeyRead


@dataclass
class ModelClass:
    """The class `Model`.

    Attributes:
        file, node: where it is defined.
        methods: its own methods and those of its base classes in the boundary, by name.
        inherited: names of methods of base classes outside the boundary.
        is_sdk: whether it derives from `xpl.Policy`, which handles environments, order and seeds itself.
        is_closed: whether every base class is known, so that no other methods exist.
    """

    source: Source
    file: str
    node: ast.ClassDef
    methods: dict[str, Function] = field(default_factory=dict)
    inherited: set[str] = field(default_factory=set)
    is_sdk: bool = False
    is_closed: bool = True
    _references: dict[int, list[Function]] = field(default_factory=dict)

    @classmethod
    def of(cls, source: Source) -> ModelClass:
        """Find the class, cached in `source`.

        Raises:
            NotRun: if model.py does not parse or does not define it.
            NotApplicable: if model.py imports it from a package that is not part of the adapter.
        """
        if cls in source.views:
            cached: ModelClass = source.views[cls]
            return cached
        class_name = source.manifest.model_class
        source.tree(sdk.File.MODEL_PY)
        definition = symbols(source, sdk.File.MODEL_PY).classes.get(class_name)
        if definition is None and origin(source, sdk.File.MODEL_PY, class_name):
            raise NotApplicable(f"model.py imports {class_name} from a package that is not part of the adapter")
        if definition is None:
            raise NotRun(f"model.py defines no class {class_name}")
        source.views[cls] = model_class = cls.from_node(source, *definition)
        return model_class

    @classmethod
    def from_node(cls, source: Source, file: str, node: ast.ClassDef) -> ModelClass:
        """Describe a class of the boundary."""
        adapter = cls(source, file, node)
        adapter._inherit(file, node, set())
        return adapter

    def _inherit(self, file: str, node: ast.ClassDef, visited: set[str]) -> None:
        defined = {  # of two definitions in one class the later one counts
            child.name: self.source.function(file, child, node)
            for child in node.body
            if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef))
        }
        self.methods = {**defined, **self.methods}
        for base in node.bases:
            name = dotted(base)
            local = None if name in visited else symbols(self.source, file).classes.get(name)
            if local is not None:
                self._inherit(*local, visited | {name})
            elif last(name) == _SDK_CLASS and origin(self.source, file, name).startswith("xpl"):
                self.is_sdk = True
                self.inherited.update(("__init__", *sdk.CONTRACT_METHODS))
            elif last(name) == _TEMPLATE:
                self.inherited.update(_TEMPLATE_GIVES)
            elif name not in {"object", "ABC", "abc.ABC"}:
                self.is_closed = False

    def has(self, name: str) -> bool:
        """Return whether the class has a method, its own or inherited."""
        return name in self.methods or name in self.inherited

    def method(self, name: str) -> Function | None:
        """Return a method that the boundary defines."""
        return self.methods.get(name)

    def reach(self, *names: str) -> list[Function]:
        """Return these methods and every function of the boundary that they may call, each once, callers first."""
        return self._walk([self.methods[name] for name in names if name in self.methods])

    def reach_from(self, *functions: Function) -> list[Function]:
        """Return these functions and every function of the boundary that they may call."""
        return self._walk(list(functions))

    def _walk(self, functions: list[Function]) -> list[Function]:
        visited = {id(function.node) for function in functions}
        for function in functions:
            key = id(function.node)
            if key not in self._references:
                self._references[key] = list(self._referenced_functions(function))
            for other in self._references[key]:
                if id(other.node) not in visited:
                    visited.add(id(other.node))
                    functions.append(other)
        return functions

    def _referenced_functions(self, function: Function) -> Iterator[Function]:
        local = symbols(self.source, function.file).functions
        for node in function.nodes:
            if (
                isinstance(node, ast.Attribute)
                and isinstance(node.value, ast.Name)
                and node.value.id in {"self", "cls"}
            ):
                if node.attr in self.methods:
                    yield self.methods[node.attr]
            elif isinstance(node, ast.Name) and node.id in local and isinstance(node.ctx, ast.Load):
                yield local[node.id]

    @cached_property
    def components(self) -> dict[str, ModelClass]:
        """Attributes that are objects of another class of the boundary, with that class."""
        classes: dict[str, ModelClass] = {}
        for function in self.reach(*LOADING):
            for node in function.nodes:
                component = self._constructed_class(function, node.value) if isinstance(node, ast.Assign) else None
                for target in targets(node) if component is not None else []:
                    attribute = _plain_attribute(target)
                    if attribute is not None and component is not None:
                        classes[attribute] = component
        return classes

    def _constructed_class(self, function: Function, value: ast.expr, depth: int = 2) -> ModelClass | None:
        """Return the class that an expression constructs, directly or by a function that returns the object."""
        if not isinstance(value, ast.Call) or depth == 0:
            return None
        cls = symbols(self.source, function.file).classes.get(dotted(value.func))
        if cls is not None:
            return ModelClass.from_node(self.source, *cls)
        maker = self.callee(function, value)
        returned = [node.value for node in maker.nodes if isinstance(node, ast.Return) and node.value] if maker else []
        return self._constructed_class(maker, returned[-1], depth - 1) if maker and returned else None

    @cached_property
    def settings(self) -> list[ConfigRead]:
        """Every expression that reads a key of the configuration, in the class or in a function that gets it."""
        return [
            ConfigRead(function, read)
            for function, is_config in self._config_readers
            for read in map(key_read, function.nodes)
            if read is not None and is_config(read.owner)
        ]

    @cached_property
    def config_escapes(self) -> bool:
        """Whether the whole configuration is passed to code outside the boundary, which may read any key."""
        return any(
            self._passes_on_config(function, node, is_config)
            for function, is_config in self._config_readers
            for node in function.nodes
        )

    @cached_property
    def config_helpers(self) -> frozenset[str]:
        """Functions of the ecosystem that get the whole configuration, and read keys of the standard from it."""
        return frozenset(
            last(called(node))
            for function, is_config in self._config_readers
            for node in function.of(ast.Call)
            if any(is_config(_unwrap_copy(value)) for value in _values(node))
            if origin(self.source, function.file, called(node)).startswith(_ECOSYSTEM)
        )

    def _passes_on_config(self, function: Function, node: ast.AST, is_config: Callable[[ast.AST], bool]) -> bool:
        if isinstance(node, ast.keyword) and node.arg is None:
            return is_config(node.value)
        if isinstance(node, (ast.For, ast.comprehension)):
            return is_config(node.iter)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and is_config(node.func.value):
            return node.func.attr in {"items", "keys", "values"} and not is_reported(node, function)
        if not isinstance(node, ast.Call) or not any(is_config(_unwrap_copy(value)) for value in _values(node)):
            return False
        if last(called(node)) in _HARMLESS or self.callee(function, node) is not None:
            return False
        is_base = self.is_closed and called(node) == "__init__"  # that of a class which is known
        return not is_base and not origin(self.source, function.file, called(node)).startswith(_ECOSYSTEM)

    @cached_property
    def _config_readers(self) -> list[tuple[Function, Callable[[ast.AST], bool]]]:
        """Every function of the class, with a test for expressions that are the configuration."""
        functions = {id(function.node): function for function in self.reach(*self.methods)}
        config_names: dict[int, set[str]] = {key: set() for key in functions}
        attributes = {"config"} if self.is_sdk else set()
        for name in LOADING:
            function = self.methods.get(name)
            if function is not None:
                config_names[id(function.node)].update(parameters(function.node)[:1])
        before = -1
        while before != (before := len(attributes) + sum(map(len, config_names.values()))):
            for key, function in functions.items():
                self._propagate_config(function, config_names[key], attributes, config_names)
        return [(function, _config_test(config_names[key], attributes)) for key, function in functions.items()]

    def _propagate_config(
        self, function: Function, local: set[str], attributes: set[str], config_names: dict[int, set[str]]
    ) -> None:
        """Add the names, attributes and parameters to which a function assigns the configuration."""
        is_config = _config_test(local, attributes)
        for node in function.nodes:
            if isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None:
                if is_config(_unwrap_copy(node.value)):
                    for target in targets(node):
                        if isinstance(target, ast.Name):
                            local.add(target.id)
                        elif (attribute := _plain_attribute(target)) is not None:
                            attributes.add(attribute)
            elif isinstance(node, ast.Call) and (other := self.callee(function, node)) is not None:
                arguments = _bind_arguments(parameters(other.node), node)
                config_names.setdefault(id(other.node), set()).update(
                    name for name, value in arguments if is_config(_unwrap_copy(value))
                )

    def callee(self, function: Function, call: ast.Call) -> Function | None:
        """Return the function of the boundary that a call refers to."""
        name = dotted(call.func)
        if name.startswith(("self.", "cls.")):
            return self.methods.get(name.partition(".")[2])
        if isinstance(call.func, ast.Name):
            return symbols(self.source, function.file).functions.get(call.func.id)
        return None


def symbols(source: Source, file: str) -> Symbols:
    """Return the classes and functions that a file defines at its top level or imports from the boundary."""
    cache = source.memory
    if file not in cache:
        cache[file] = table = Symbols()
        try:
            tree = source.tree(file)
        except NotRun:
            return table
        modules = source.imports(file)
        for node in _top_level(tree.body):
            if isinstance(node, ast.ClassDef):
                table.classes[node.name] = (file, node)
            elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                table.functions[node.name] = source.function(file, node)
            elif isinstance(node, ast.ImportFrom):
                module = modules.get("." * node.level + (node.module or ""))
                other = Symbols() if module is None else symbols(source, module)
                for alias in node.names:
                    name = alias.asname or alias.name
                    if alias.name in other.classes:
                        table.classes[name] = other.classes[alias.name]
                    if alias.name in other.functions:
                        table.functions[name] = other.functions[alias.name]
    return cache[file]


def _top_level(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Yield the statements of a module, those inside `if` and `try` too."""
    for statement in body:
        yield statement
        for block in ("body", "orelse", "finalbody"):
            if isinstance(statement, (ast.If, ast.Try)):
                yield from _top_level(getattr(statement, block, []))
        for handler in getattr(statement, "handlers", []):
            yield from _top_level(handler.body)


def origin(source: Source, file: str, name: str) -> str:
    """Return the module that a name was imported from."""
    top = name.partition(".")[0]
    for node in source.nodes(file):
        if isinstance(node, ast.ImportFrom) and not node.level:
            if any((alias.asname or alias.name) == top for alias in node.names):
                return node.module or ""
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if (alias.asname or alias.name.partition(".")[0]) == top:
                    return alias.name
    return ""


def _plain_attribute(node: ast.AST) -> str | None:
    return self_attribute(node) if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) else None


def _unwrap_copy(node: ast.expr) -> ast.expr:
    """Return the original of a copy: `config` for `dict(config)`, `config.copy()`, `config or {}`."""
    if isinstance(node, ast.Call):
        name = last(called(node))
        if name in {"dict", "copy", "deepcopy"} and isinstance(node.func, ast.Attribute) and not node.args:
            return node.func.value
        if name in {"dict", "copy", "deepcopy"} and len(node.args) == 1:
            return node.args[0]
    if isinstance(node, ast.BoolOp):
        return node.values[0]
    return node


def _config_test(local: set[str], attributes: set[str]) -> Callable[[ast.AST], bool]:
    def is_config(node: ast.AST) -> bool:
        if isinstance(node, ast.Name):
            return node.id in local
        return _plain_attribute(node) in attributes if isinstance(node, ast.Attribute) else False

    return is_config


def _values(call: ast.Call) -> list[ast.expr]:
    return [*call.args, *(keyword.value for keyword in call.keywords)]


def _bind_arguments(names: list[str], call: ast.Call) -> list[tuple[str, ast.expr]]:
    """Return the parameters that a call sets, with their arguments."""
    positional = list(zip(names, call.args, strict=False))
    return positional + [(keyword.arg, keyword.value) for keyword in call.keywords if keyword.arg in names]
