"""XPL105: model.py defines the class Model with all five operations."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotRun, rule
from xpl_cli.audit.static.model_class import ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, last

_CONSEQUENCE = "a client that calls it gets an error"


@rule(code="XPL105", requirement="XPL-CON-2")
def contract_methods(source: Source) -> Iterator[Finding]:
    """The class Model is missing, or lacks an operation that clients call.

    ## What it does
    Looks for the class, its five operations, and those of its base classes. `xpl.Policy` has all of them; the base
    class of the XPolicyLab template has them in name only: its batch operations raise `NotImplementedError`. A method
    that does nothing but raise `NotImplementedError` counts as missing.

    ## Why it matters
    Benchmarks that evaluate in batches call `update_obs_batch` and `get_action_batch`. An adapter that lacks them fails
    at the first step of the first episode.

    ## Example
    Batch operations that are commented out, because the author evaluated only one environment.

    ## Use instead
    Derive from `xpl.Policy`, or implement the single operations with the batched ones.

    ## Fix safety
    No automatic fix.
    """
    name = sdk.File.MODEL_PY
    class_name = source.manifest.model_class
    tree = source.tree(name)
    try:
        adapter = ModelClass.of(source)
    except NotRun:
        yield Finding(
            f"{name} has no class {class_name}: the server has nothing to construct",
            path=name,
            line=1,
            column=1,
            expected=f"class {class_name}",
            got=", ".join(node.name for node in tree.body if isinstance(node, ast.ClassDef)) or "no class",
            fix=Fix("advice", f"define class {class_name}, or import it under that name"),
        )
        return
    missing = [method for method in sdk.CONTRACT_METHODS if adapter.is_closed and not adapter.has(method)]
    if missing:
        yield Finding(
            f"{class_name} lacks {' and '.join(missing)}: {_CONSEQUENCE}",
            **source.start(adapter.file, adapter.node),
            expected=", ".join(sdk.CONTRACT_METHODS),
            got=", ".join(sorted(adapter.methods)),
            fix=Fix("advice", "derive from xpl.Policy, which implements all of them, or write them"),
        )
    for method in sdk.CONTRACT_METHODS:
        function = adapter.method(method)
        if function is not None and _is_stub(function.node.body):
            yield Finding(
                f"{method} only raises NotImplementedError: {_CONSEQUENCE}",
                **source.at(function.file, function.node),
                expected="an implementation",
                got="raise NotImplementedError",
                fix=Fix("advice", "derive from xpl.Policy, or write it"),
            )


def _is_stub(body: list[ast.stmt]) -> bool:
    work = [entry for entry in body if not (isinstance(entry, ast.Expr) and isinstance(entry.value, ast.Constant))]
    if len(work) != 1 or not isinstance(work[0], ast.Raise) or work[0].exc is None:
        return False
    raised = work[0].exc
    return last(called(raised) or getattr(raised, "id", "")) == "NotImplementedError"
