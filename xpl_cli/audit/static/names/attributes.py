"""What an adapter reads from the modules that it imports: `xpl.rotation.to_matrix`, and names that are not there."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.audit.static.names import offered, resolving
from xpl_cli.audit.static.names.imports import certain, live
from xpl_cli.audit.static.names.offered import Module
from xpl_cli.audit.static.syntax import bound, dotted, last

if TYPE_CHECKING:
    from xpl_cli.audit.static.names.imports import Imported
    from xpl_cli.audit.static.source import Source


@dataclass(frozen=True)
class Absent:
    """A name that is read from a module and is not there.

    Attributes:
        file, node: where.
        owner: the module as it is written there, such as `xpl.rotation`.
        name: what it lacks.
        module: what was looked through.
    """

    file: str
    node: ast.Attribute
    owner: str
    name: str
    module: Module


def absent(source: Source) -> Iterator[Absent]:
    """Yield what is read from the SDK's and the adapter's own modules, and is certain not to be there.

    Left alone: names that anything but one import binds in a file, modules that are handed on, names that are written
    or asked for as text, and what stands where an `AttributeError` is dealt with.
    """
    imports: dict[str, list[Imported]] = defaultdict(list)
    for imported in live(source):
        imports[imported.file].append(imported)
    meant = {file: _modules(source, file, found) for file, found in imports.items()}
    handed_on = {
        modules[node.id] for file, modules in meant.items() for node in _alone(source, file) if node.id in modules
    }
    spoken = set(_spoken(source))
    for file, body in certain(source, "AttributeError"):
        modules = meant.get(file) or {}
        for node in _read(body) if modules else ():
            first, *owners, name = dotted(node).split(".") if dotted(node) else ("", "")
            if first not in modules or name in spoken or name.startswith("__"):
                continue
            found = _last_module(source, modules[first], owners)
            if found is None or found in handed_on or resolving.has(found, resolving.offer_of(source, found), name):
                continue
            if not (found.folder and resolving.is_made_elsewhere(source, name)):
                yield Absent(file, node, ".".join((first, *owners)), name, found)


def _last_module(source: Source, module: Module, parts: list[str]) -> Module | None:
    """Follow attributes as long as they are modules; None where one of them is something else."""
    for part in parts:
        if module.folder is None or resolving.offer_of(source, module).has(part):
            return None
        inner = offered.located(module.folder, (part,))
        if not isinstance(inner, Module):
            return None
        module = inner
    return module


def _modules(source: Source, file: str, imports: list[Imported]) -> dict[str, Module]:
    """Return what names of a file mean, of those that are certain to mean one module of the SDK or of the adapter."""
    meant: dict[str, set[Module | None]] = defaultdict(set)
    unguarded = {imported.node for imported in imports}
    for node in source.nodes(file):
        if node not in unguarded:
            for name in _bound_anywhere(node):
                meant[name].add(None)
    for imported in imports:
        for name, module in _bindings(source, imported):
            meant[name].add(module)
    single = {name: next(iter(modules)) for name, modules in meant.items() if len(modules) == 1}
    return {name: module for name, module in single.items() if module is not None}


def _bound_anywhere(node: ast.AST) -> list[str]:
    if isinstance(node, ast.arg):
        return [node.arg]
    if isinstance(node, ast.ExceptHandler) and node.name:
        return [node.name]
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Del):
        return [node.id]
    return bound(node)


def _bindings(source: Source, imported: Imported) -> Iterator[tuple[str, Module | None]]:
    begin = resolving.start(source, imported)
    node = imported.node
    if isinstance(node, ast.ImportFrom):
        home = None if begin is None else offered.located(*begin)
        for alias in node.names:
            yield alias.asname or alias.name, _submodule(source, home, alias.name)
        return
    alias = next(entry for entry in node.names if entry.name == imported.module)
    parts = begin[1] if begin is not None else ()
    if alias.asname is None:  # `import a.b` binds a
        parts = parts[: len(parts) - len(imported.parts) + 1]
    module = None if begin is None else offered.located(begin[0], parts)
    yield alias.asname or imported.parts[0], module if isinstance(module, Module) else None


def _submodule(source: Source, home: object, name: str) -> Module | None:
    """Return the module that `from home import name` takes, None if it takes something else."""
    if not isinstance(home, Module) or home.folder is None or resolving.offer_of(source, home).has(name):
        return None
    module = offered.located(home.folder, (name,))
    return module if isinstance(module, Module) else None


def _read(nodes: Iterator[ast.AST]) -> Iterator[ast.Attribute]:
    """Yield the attributes that are read, none of those in annotations."""
    unread: set[ast.AST] = set()
    for node in nodes:
        for annotation in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            unread.update(ast.walk(annotation) if isinstance(annotation, ast.AST) else ())
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load) and node not in unread:
            yield node


def _alone(source: Source, file: str) -> Iterator[ast.Name]:
    """Yield the names of a file that stand for themselves, so that somebody may change what they mean."""
    owners = {node.value for node in source.nodes(file) if isinstance(node, ast.Attribute)}
    return (node for node in source.nodes(file) if isinstance(node, ast.Name) and node not in owners)


def _spoken(source: Source) -> Iterator[str]:
    """Yield the names of attributes that are written, and those that stand in a text of their own."""
    for file in source.python_files:
        for node in source.nodes(file) if source.parses(file) else ():
            if isinstance(node, ast.Attribute) and not isinstance(node.ctx, ast.Load):
                yield node.attr
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield last(node.value)
