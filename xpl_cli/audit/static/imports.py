"""Imports of a Python file from its own package."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli.audit.static import file_reading

if TYPE_CHECKING:
    from collections.abc import Iterable


def own_imports(package: Path, name: str, nodes: Iterable[ast.AST]) -> dict[str, str]:
    """Return the package's modules that a file imports: dotted name as written, to file.

    Args:
        package: the package's folder, resolved.
        name: of the file, relative to the folder.
        nodes: everything in it.
    """
    files: dict[str, str] = {}
    here = name.rpartition("/")[0]
    for node in nodes:
        candidates: list[tuple[str, int]] = []
        if isinstance(node, ast.Import):
            candidates = [(alias.name, 0) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            dot = "." if node.module else ""
            candidates = [(node.module or "", node.level)]
            candidates += [(f"{node.module or ''}{dot}{alias.name}", node.level) for alias in node.names]
        for module, level in candidates:
            file = _file(package, module, level, here)
            if file is not None and file != name:
                files["." * level + module] = file
    return files


def _file(package: Path, module: str, level: int, here: str) -> str | None:
    """Return the file of an imported module, if it is the package's own."""
    for ecosystem in (f"XPolicyLab.policy.{package.name}.", f"policy.{package.name}."):
        if not level and module.startswith(ecosystem):  # an adapter by its place in the ecosystem's checkout
            module, here = module.removeprefix(ecosystem), ""
    base = Path(here)
    for _ in range(level - 1):
        if base == Path():
            return None
        base = base.parent
    bases = [base] if level else [base, Path()]
    places = [folder / module.replace(".", "/") for folder in bases if module]
    candidates = [place.with_suffix(".py").as_posix() for place in places]
    candidates += [f"{place.as_posix()}/{sdk.File.INIT_PY}" for place in places]
    return next(filter(None, (file_reading.resolve_inside(package, candidate) for candidate in candidates)), None)
