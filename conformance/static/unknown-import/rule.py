"""XPL189: What the adapter imports from the SDK and from itself is there."""

from __future__ import annotations

import difflib
import re
import sys
from collections.abc import Iterable, Iterator
from fnmatch import fnmatch
from pathlib import Path

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.names import offered
from xpl_cli.audit.static.names.imports import Imported, live
from xpl_cli.audit.static.names.offered import SDK, Missing, Module, Offer
from xpl_cli.audit.static.source import Source


@rule(code="XPL189", requirement="XPL-CON-1")
def unknown_import(source: Source) -> Iterator[Finding]:
    """An import names a module or a name that is not there.

    ## What it does
    Compares `import xpl...` and `from xpl... import name` with the SDK, and imports of the adapter's own modules with
    its files; nothing is executed. Only what is certain to fail is reported. Left alone: imports under `try` with
    `except ImportError`, under `TYPE_CHECKING` or a question about versions; modules that make names themselves (star
    imports, `__getattr__`, `globals()`), compiled or generated ones, and trees of other projects.

    ## Why it matters
    The server cannot import model.py, so that there is no `Model`; inside a function, the import fails in the middle of
    a run. Both are found on the machine with the GPU, after the queue.

    ## Example
    `from xpl.observation import get_picture`: the SDK has `get_image`.

    ## Use instead
    The name as the SDK or the adapter's own module spells it; the finding tells the nearest one.

    ## Fix safety
    No automatic fix: where the name is used, it has to change too.
    """
    for imported in live(source):
        if imported.parts[:1] == (SDK,) and imported.level == 0:
            if not {SDK, f"{SDK}.py"} & offered.listed(source.path):
                yield from _of_the_sdk(source, imported)
        else:
            yield from _of_its_own(source, imported)


def _of_the_sdk(source: Source, imported: Imported) -> Iterator[Finding]:
    module = offered.located(offered.sdk_root(), imported.parts[1:])
    if isinstance(module, Missing):
        shown = imported.module or SDK
        names = [name for name in offered.sdk_modules() if name.count(".") == shown.count(".")]
        yield _finding(source, imported, f"the SDK has no module {shown}", shown, _near(shown, names))
    if not isinstance(module, Module):
        return
    for name in imported.names:
        offer = offered.sdk_offer(module.file) if module.file is not None else Offer(frozenset(), is_open=False)
        if not _has(module, offer, name):
            homes = offered.sdk_homes()
            here = _near(name, [entry for entry in offer.names if not entry.startswith("_")])
            hint = f"{homes[name]} defines {name}" if name in homes else here
            if not hint and (nearest := difflib.get_close_matches(name, homes, 1)):
                hint = f"{homes[nearest[0]]} defines {nearest[0]}"
            yield _finding(source, imported, f"{imported.module} of the SDK has no {name}", name, hint)


def _of_its_own(source: Source, imported: Imported) -> Iterator[Finding]:
    begin = _begin(source, imported)
    if begin is None:
        return
    folder, parts = begin
    module = offered.located(folder, parts)
    if isinstance(module, Missing) and (module.folder is None or not _is_made_elsewhere(source, module.part)):
        near = _near(module.part, _modules(module.folder))
        yield _finding(source, imported, f"the adapter has no module {imported.module}", imported.module, near)
    if not isinstance(module, Module):
        return
    for name in imported.names:
        offer = _offer(source, module)
        modules = _modules(module.folder)
        if not _has(module, offer, name) and not (module.folder and _is_made_elsewhere(source, name)):
            where = imported.module if imported.module.strip(".") else "the adapter"
            yield _finding(source, imported, f"{where} defines no {name}", name, _near(name, [*offer.names, *modules]))


def _begin(source: Source, imported: Imported) -> tuple[Path, tuple[str, ...]] | None:
    """Return the folder of the adapter that an import starts from, with what follows; None if it is not its own."""
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


def _own(folder: Path, top: str) -> Module | Missing | None:
    """Return what a top-level name means in a folder; a folder without `__init__.py` may belong to anybody."""
    module = offered.located(folder, (top,))
    return None if isinstance(module, Module) and module.file is None else module


def _has(module: Module, offer: Offer, name: str) -> bool:
    if name == "*" or offer.has(name):
        return True
    return module.folder is not None and not isinstance(offered.located(module.folder, (name,)), Missing)


def _offer(source: Source, module: Module) -> Offer:
    if module.file is None:
        return Offer(frozenset(), is_open=False)
    name = module.file.relative_to(source.path.resolve()).as_posix()
    return offered.offer(source.tree(name)) if source.parses(name) else Offer(frozenset(), is_open=True)


def _is_made_elsewhere(source: Source, name: str) -> bool:
    """Tell whether something else may bring a module: what git leaves out, and what the installation makes."""
    for file in (".gitignore", ".gitmodules", sdk.File.INSTALL_SH):
        text = source.text(file) if source.has(file) else ""
        patterns = [line.strip().strip("/") for line in text.split("\n")] if file == ".gitignore" else []
        if re.search(rf"\b{re.escape(name)}\b", text) or any(fnmatch(f"{name}.py", entry) for entry in patterns):
            return True
    return False


def _modules(folder: Path | None) -> set[str]:
    names = offered.listed(folder) if folder is not None else ()
    return {name.removesuffix(".py") for name in names if name.endswith(".py")} - {"__init__"}


def _near(name: str, choices: Iterable[str]) -> str:
    nearest = difflib.get_close_matches(name, sorted(choices), 1)
    return f"did you mean {nearest[0]}?" if nearest else ""


def _finding(source: Source, imported: Imported, message: str, got: str, hint: str) -> Finding:
    return Finding(
        f"{message}: the import fails",
        **source.at(imported.file, imported.node),
        expected="a module and names that are there",
        got=got,
        fix=Fix("advice", hint or "correct the import, or add what it names"),
    )
