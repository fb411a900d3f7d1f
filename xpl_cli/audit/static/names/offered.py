"""Which modules there are below a folder, and which names each offers to who imports it; read, never executed."""

from __future__ import annotations

import ast
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import xpl
from xpl import _spec as sdk
from xpl_cli.audit.static.syntax import SCOPES, bound, called, dotted, last, texts

SDK: Final = "xpl"

_ALWAYS: Final = frozenset(
    ("__name__", "__file__", "__doc__", "__package__", "__spec__", "__loader__", "__path__", "__dict__")
)
_BINDS_ANYTHING: Final = frozenset(("globals", "exec"))
_OWN_NAMES: Final = frozenset(("vars", "locals"))
"""Functions that, without an argument, give the names of the module to be changed."""
_COMPREHENSIONS: Final = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
_FOREIGN: Final = frozenset((".git", "pyproject.toml", "setup.py", "setup.cfg"))
_FOREIGN_NAMES: Final = frozenset(("third_party", "thirdparty", "3rdparty", "vendor", "external", "submodules"))


@dataclass(frozen=True)
class Offer:
    """What a module offers.

    Attributes:
        names: every name that it binds when it is imported.
        is_open: whether it may offer others too: by a star import, `__getattr__`, `globals()` and their like.
    """

    names: frozenset[str]
    is_open: bool

    def has(self, name: str) -> bool:
        """Tell whether the name is there, or may be."""
        return self.is_open or name in self.names or name in _ALWAYS


@dataclass(frozen=True)
class Module:
    """A module that a dotted name leads to.

    Attributes:
        file: its source, None for a folder without `__init__.py`.
        folder: where its submodules lie, None for a plain file.
    """

    file: Path | None
    folder: Path | None


@dataclass(frozen=True)
class Missing:
    """A dotted name that leads nowhere: the first part that is not there, and the folder it should be in."""

    part: str
    folder: Path | None


def located(folder: Path, parts: Iterable[str]) -> Module | Missing | None:
    """Follow a dotted name from a folder.

    Returns:
        the module; what is missing; or None where nobody can know: compiled modules, and folders that are somebody
        else's package or have not been fetched.
    """
    module = Module(_file(folder, sdk.File.INIT_PY), folder)
    for part in parts:
        here = module.folder
        if here is None:
            return Missing(part, None)
        inner, names = here / part, listed(here)
        if part in names and os.path.isdir(inner):  # noqa: PTH112 - Path.is_dir raises where nobody may look
            if part in _FOREIGN_NAMES or _FOREIGN & listed(inner) or not any(inner.rglob("*.py")):
                return None
            module = Module(_file(inner, sdk.File.INIT_PY), inner)
        elif f"{part}.py" in names:
            module = Module(here / f"{part}.py", None)
        elif any(name.startswith(f"{part}.") for name in names):
            return None
        else:
            return Missing(part, here)
    return module


def offer(tree: ast.Module) -> Offer:
    """Return what a module offers, by its syntax tree; what is defined under a condition counts as there."""
    given = {name for node in run_at_import(tree.body) for name in bound(node)}
    given |= {node.target.id for node in _outside_scopes(tree.body) if isinstance(node, ast.NamedExpr)}
    is_open = bool(given & {"*", "__getattr__"})
    for node in ast.walk(tree):
        if isinstance(node, ast.Global):
            given.update(node.names)
        elif isinstance(node, ast.Call):
            is_open |= called(node) in _BINDS_ANYTHING or (called(node) in _OWN_NAMES and not node.args)
        is_open |= dotted(node) == "sys.modules"
    return Offer(frozenset(given), is_open)


def run_at_import(nodes: Iterable[ast.AST]) -> Iterator[ast.AST]:
    """Yield what is executed when a module is imported; functions and classes are not entered."""
    for node in nodes:
        yield node
        if isinstance(node, (*SCOPES, *_COMPREHENSIONS)):  # which have names of their own
            continue
        is_for_checkers = isinstance(node, ast.If) and is_type_checking(node.test)
        yield from run_at_import(node.orelse if is_for_checkers else ast.iter_child_nodes(node))  # type: ignore[attr-defined]


def _outside_scopes(nodes: Iterable[ast.AST]) -> Iterator[ast.AST]:
    """Yield what lies in no function or class; a comprehension hands on what `:=` binds in it."""
    for node in nodes:
        yield node
        if not isinstance(node, SCOPES):
            yield from _outside_scopes(ast.iter_child_nodes(node))


def is_type_checking(test: ast.expr) -> bool:
    """Tell whether a condition holds for type checkers only."""
    return last(dotted(test)) == "TYPE_CHECKING"


def sdk_root() -> Path:
    """Return the folder of the SDK."""
    return Path(xpl.__file__).parent


@cache
def sdk_offer(file: Path) -> Offer:
    """Return what a module of the SDK offers, no more; one that imports on first use lists its names in `__all__`."""
    return Offer(offer(ast.parse(file.read_text(encoding="utf-8"))).names | sdk_listed(file), is_open=False)


@cache
def sdk_listed(file: Path) -> frozenset[str]:
    """Return what `__all__` of a module of the SDK lists."""
    body = ast.parse(file.read_text(encoding="utf-8")).body
    lists = (node.value for node in body if isinstance(node, ast.Assign) and dotted(node.targets[0]) == "__all__")
    return frozenset(name for value in lists for name in texts(value))


@cache
def sdk_modules() -> tuple[str, ...]:
    """Return the public modules of the SDK by their dotted names, those nearest to its root first."""
    root = sdk_root()
    files = sorted(root.rglob("*.py"), key=lambda file: (len(file.parts), file))
    names = (".".join([SDK, *file.relative_to(root).with_suffix("").parts]) for file in files)
    return tuple(name.removesuffix(".__init__") for name in names if "._" not in name.removesuffix(".__init__"))


@cache
def sdk_homes() -> dict[str, str]:
    """Return the public classes and functions of the SDK, each with the module to import it from."""
    found: dict[str, str] = {}
    for name in sdk_modules():
        module = located(sdk_root(), name.split(".")[1:])
        if not isinstance(module, Module) or module.file is None:
            continue
        body = ast.parse(module.file.read_text(encoding="utf-8")).body
        defined = {node.name for node in body if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
        for public in defined | sdk_listed(module.file):
            if not public.startswith("_"):
                found.setdefault(public, name)
    return found


def listed(folder: Path) -> frozenset[str]:
    """Return the names in a folder; none where nobody may look."""
    try:
        return frozenset(entry.name for entry in folder.iterdir())
    except OSError:
        return frozenset()


def _file(folder: Path, name: str) -> Path | None:
    return folder / name if name in listed(folder) else None
