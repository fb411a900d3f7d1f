"""XPL108: Importing model.py needs no library of the policy."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.source import Source

_ALWAYS_THERE = frozenset((*sys.stdlib_module_names, "numpy", "xpl"))


@rule(code="XPL108", requirement="XPL-CON-4")
def heavy_imports(source: Source) -> Iterator[Finding]:
    """Importing model.py requires the libraries of the policy.

    ## What it does
    Lists what an import of model.py imports, besides the standard library, numpy, `xpl` and files of the adapter. Not
    reported: imports inside functions and under `if TYPE_CHECKING:`.

    ## Why it matters
    Some tools import an adapter without its libraries: the audit in shadow mode, documentation, comparisons. With
    imports inside `load` they can, and the server reports progress and errors while a large library loads.

    ## Example
    `import torch` at the top of model.py.

    ## Use instead
    Import inside `load(config)`, and store the modules that later calls need as attributes.

    ## Fix safety
    No automatic fix.
    """
    if source.is_ecosystem:
        raise NotApplicable("adapters of the ecosystem import their libraries at the top")
    name = sdk.File.MODEL_PY
    own = set(source.imports(name))
    for node in _while_importing(source.tree(name).body):
        modules: list[str] = []
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            modules = [node.module]
        for module in modules:
            if module.partition(".")[0] not in _ALWAYS_THERE and module not in own:
                yield Finding(
                    f"{name} cannot be imported without {module}, not even to inspect it",
                    **source.at(name, node),
                    expected="the import inside load()",
                    got=ast.unparse(node),
                    fix=Fix("advice", "move the import into load(), or into the function that uses it"),
                )


def _while_importing(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    for node in body:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        if isinstance(node, (ast.If, ast.Try, ast.With, ast.For, ast.While)):
            for block in ("body", "orelse", "finalbody"):
                yield from _while_importing(getattr(node, block, []))
