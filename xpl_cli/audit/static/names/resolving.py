"""What the dotted names of an adapter lead to: modules of the SDK, and its own."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli.audit.static.names import offered
from xpl_cli.audit.static.names.offered import SDK, Missing, Module, Offer

if TYPE_CHECKING:
    from xpl_cli.audit.static.names.imports import Imported
    from xpl_cli.audit.static.source import Source


def is_of_the_sdk(imported: Imported) -> bool:
    """Tell whether an import begins at the SDK."""
    return imported.parts[:1] == (SDK,) and imported.level == 0


def has_own_sdk(source: Source) -> bool:
    """Tell whether the package holds something that bears the SDK's name, so that nobody knows which is meant."""
    return bool({SDK, f"{SDK}.py"} & offered.listed(source.path))


def start(source: Source, imported: Imported) -> tuple[Path, tuple[str, ...]] | None:
    """Return the folder that an import starts from, with what follows.

    Returns:
        None if it is neither the SDK's nor the adapter's own, or nobody can know.
    """
    if is_of_the_sdk(imported):
        return None if has_own_sdk(source) else (offered.sdk_root(), imported.parts[1:])
    root = source.path.resolve()
    here = (root / imported.file).parent
    if imported.level:
        folder = here
        for _ in range(imported.level - 1):
            folder = folder.parent
        return (folder, imported.parts) if folder == root or root in folder.parents else None
    top = imported.parts[0]
    if top in sys.stdlib_module_names or not imported.is_path_known:
        return None
    homes = {folder for folder in (here, root) if isinstance(_own(folder, top), Module)}
    return (homes.pop(), imported.parts) if len(homes) == 1 else None


def offer_of(source: Source, module: Module) -> Offer:
    """Return what a module of the SDK or of the adapter offers."""
    if module.file is None:
        return Offer(frozenset(), is_open=False)
    if offered.sdk_root() in module.file.parents:
        return offered.sdk_offer(module.file)
    name = module.file.relative_to(source.path.resolve()).as_posix()
    return offered.offer(source.tree(name)) if source.parses(name) else Offer(frozenset(), is_open=True)


def has(module: Module, offer: Offer, name: str) -> bool:
    """Tell whether a module has a name, or may have: one that it offers, or a module below it."""
    if name == "*" or offer.has(name):
        return True
    return module.folder is not None and not isinstance(offered.located(module.folder, (name,)), Missing)


def is_made_elsewhere(source: Source, name: str) -> bool:
    """Tell whether something else may bring a module: what git leaves out, and what the installation makes."""
    for file in (".gitignore", ".gitmodules", sdk.File.INSTALL_SH):
        text = source.text(file) if source.has(file) else ""
        patterns = [line.strip().strip("/") for line in text.split("\n")] if file == ".gitignore" else []
        if re.search(rf"\b{re.escape(name)}\b", text) or any(fnmatch(f"{name}.py", entry) for entry in patterns):
            return True
    return False


def modules_in(folder: Path | None) -> set[str]:
    """Return the names of the modules in a folder."""
    names: Iterable[str] = offered.listed(folder) if folder is not None else ()
    return {name.removesuffix(".py") for name in names if name.endswith(".py")} - {"__init__"}


def _own(folder: Path, top: str) -> Module | Missing | None:
    """Return what a top-level name means in a folder; a folder without `__init__.py` may belong to anybody."""
    module = offered.located(folder, (top,))
    return None if isinstance(module, Module) and module.file is None else module
