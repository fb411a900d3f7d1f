"""XPL189: What the adapter imports from the SDK and from itself is there."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.names import offered, resolving
from xpl_cli.audit.static.names.attributes import Absent, absent
from xpl_cli.audit.static.names.imports import Imported, live
from xpl_cli.audit.static.names.offered import SDK, Missing, Module
from xpl_cli.audit.static.source import Source


@rule(code="XPL189", requirement="XPL-CON-1")
def unknown_import(source: Source) -> Iterator[Finding]:
    """An import names a module or a name that is not there.

    ## What it does
    Compares `import xpl...` and `from xpl... import name` with the SDK, and imports of the adapter's own modules with
    its files; nothing is executed. What is read from an imported module (`xpl.action.unpack`) has to be there, too.
    Only what is certain to fail is reported. Left alone: imports under `try` with `except ImportError`, under
    `TYPE_CHECKING` or a question about versions; modules that make names themselves (star imports, `__getattr__`,
    `globals()`), compiled or generated ones, and trees of other projects; modules that are handed on or written to.

    ## Why it matters
    The server cannot import model.py, so that there is no `Model`; inside a function, the import or the name fails in
    the middle of a run. Both are found on the machine with the GPU, after the queue.

    ## Example
    `from xpl.observation import get_picture`: the SDK has `get_image`.

    ## Use instead
    The name as the SDK or the adapter's own module spells it; the finding tells the nearest one.

    ## Fix safety
    No automatic fix: where the name is used, it has to change too.
    """
    for imported in live(source):
        if not resolving.is_of_the_sdk(imported):
            yield from _of_its_own(source, imported)
        elif not resolving.has_own_sdk(source):
            yield from _of_the_sdk(source, imported)
    for entry in absent(source):
        yield _attribute(source, entry)


def _of_the_sdk(source: Source, imported: Imported) -> Iterator[Finding]:
    module = offered.located(offered.sdk_root(), imported.parts[1:])
    if isinstance(module, Missing):
        shown = imported.module or SDK
        names = [name for name in offered.sdk_modules() if name.count(".") == shown.count(".")]
        yield _finding(source, imported, f"the SDK has no module {shown}", shown, _near(shown, names))
    if not isinstance(module, Module):
        return
    offer = resolving.offer_of(source, module)
    for name in imported.names:
        if not resolving.has(module, offer, name):
            hint = _in_the_sdk(name, offer.names)
            yield _finding(source, imported, f"{imported.module} of the SDK has no {name}", name, hint)


def _of_its_own(source: Source, imported: Imported) -> Iterator[Finding]:
    begin = resolving.start(source, imported)
    if begin is None:
        return
    folder, parts = begin
    module = offered.located(folder, parts)
    if isinstance(module, Missing) and (module.folder is None or not resolving.is_made_elsewhere(source, module.part)):
        near = _near(module.part, resolving.modules_in(module.folder))
        yield _finding(source, imported, f"the adapter has no module {imported.module}", imported.module, near)
    if not isinstance(module, Module):
        return
    offer = resolving.offer_of(source, module)
    for name in imported.names:
        is_there = resolving.has(module, offer, name)
        if not is_there and not (module.folder and resolving.is_made_elsewhere(source, name)):
            where = imported.module if imported.module.strip(".") else "the adapter"
            near = _near(name, [*offer.names, *resolving.modules_in(module.folder)])
            yield _finding(source, imported, f"{where} defines no {name}", name, near)


def _attribute(source: Source, entry: Absent) -> Finding:
    offer = resolving.offer_of(source, entry.module)
    is_of_the_sdk = entry.module.file is not None and offered.sdk_root() in entry.module.file.parents
    here = [*offer.names, *resolving.modules_in(entry.module.folder)]
    hint = _in_the_sdk(entry.name, here) if is_of_the_sdk else _near(entry.name, here)
    return Finding(
        f"{entry.owner} has no {entry.name}: an AttributeError where it is used",
        **source.at(entry.file, entry.node),
        expected="a name that the module has",
        got=f"{entry.owner}.{entry.name}",
        fix=Fix("advice", hint or "correct the name, or define it"),
    )


def _in_the_sdk(name: str, here: Iterable[str]) -> str:
    """Return where in the SDK a name is, or the nearest one: of a module, then of all."""
    homes = offered.sdk_homes()
    if name in homes:
        return f"{homes[name]} defines {name}"
    near = _near(name, [entry for entry in here if not entry.startswith("_")])
    if not near and (nearest := difflib.get_close_matches(name, homes, 1)):
        return f"{homes[nearest[0]]} defines {nearest[0]}"
    return near


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
