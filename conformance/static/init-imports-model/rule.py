"""XPL107: The package's __init__.py does not import the model."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import descendants


@rule(code="XPL107", requirement="XPL-CON-5")
def init_imports_model(source: Source) -> Iterator[Finding]:
    """__init__.py imports the model, and with it the libraries of the policy.

    ## What it does
    Looks at what an import of the package imports: model.py, directly or through another module of the adapter. Imports
    inside functions are not reported; they run when the function is called.

    ## Why it matters
    A simulator imports the package to get `deploy.py`. It then loads the policy's libraries into its own Python:
    another torch, another numpy, GPU memory. Inside `try: ... except ImportError: pass` the errors of both are hidden.

    ## Example
    `from .model import Model` in `__init__.py`, for the convenience of a `get_model` function.

    ## Use instead
    An `__init__.py` with a docstring only. The server imports model.py by its path.

    ## Fix safety
    No automatic fix: other code may use the name.
    """
    name = sdk.File.INIT_PY
    model = sdk.File.MODEL_PY
    for node in descendants(source.tree(name)):
        if not isinstance(node, (ast.Import, ast.ImportFrom)):
            continue
        for file in _imported(source, node):
            way = [file] if file == model else ([file, model] if model in source.reached(file) else [])
            if way:
                yield Finding(
                    f"importing the package imports {', and that imports '.join(way)}: a simulator that needs "
                    f"{sdk.File.DEPLOY_PY} loads the policy's libraries too",
                    **source.at(name, node),
                    expected="no import of the model",
                    got=ast.unparse(node),
                    fix=Fix("advice", "delete the import, or move it into the function that needs it"),
                )


def _imported(source: Source, node: ast.Import | ast.ImportFrom) -> list[str]:
    """Return the adapter's own files that one import statement of __init__.py runs."""
    modules = source.imports(sdk.File.INIT_PY)
    if isinstance(node, ast.Import):
        imported = [alias.name for alias in node.names]
    else:
        module = "." * node.level + (node.module or "")
        imported = [module, *(f"{module}{'.' if node.module else ''}{alias.name}" for alias in node.names)]
    return list(dict.fromkeys(modules[entry] for entry in imported if entry in modules))
