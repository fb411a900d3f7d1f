"""XPL119: A default in code also applies where deploy.yml says null."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.model_class import ConfigRead, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, targets
from xpl_cli.standard import spec

_CONVERSIONS = frozenset(("int", "float", "str", "bool", "list", "dict", "tuple", "Path"))


@rule(code="XPL119", requirement="XPL-CFG-6")
def null_defeats_default(source: Source) -> Iterator[Finding]:
    """deploy.yml sets a key to null, and the default in the code does not apply.

    ## What it does
    Takes the keys that `deploy.yml` sets to null and finds the code that reads them with `config.get(key, default)`.
    The default applies to a missing key only: here the value is None. Not reported: keys that launchers set, and code
    that handles None afterwards.

    ## Why it matters
    The policy then runs with None where the author expects the default, without a prompt for example, or it ends with a
    TypeError.

    ## Example
    `prompt: null` in `deploy.yml` and `config.get("prompt", task_name)` in model.py.

    ## Use instead
    `self.setting("prompt", task_name)` of `xpl.Policy`, or drop the key from `deploy.yml`.

    ## Fix safety
    No automatic fix: `or` would also replace 0, false and the empty string.
    """
    package = spec.data("package")
    script_arguments = {name.strip("[]") for names in package["scripts"].values() for name in names}
    nulls = {key for key, value in source.deploy.items() if value is None} - script_arguments
    for setting in ModelClass.of(source).settings:
        read = setting.read
        if read.key not in nulls or read.default is None or constant(read.default) is None:
            continue
        if not _handles_none(setting):
            default = ast.unparse(read.default)
            yield Finding(
                f"{read.key} is null in {sdk.File.DEPLOY_YML}, so the policy gets None here and not {default}",
                **source.at(setting.function.file, read.node),
                expected=default,
                got="None",
                fix=Fix("advice", f"self.setting({read.key!r}, {default}), or delete `{read.key}: null`"),
            )


def _handles_none(setting: ConfigRead) -> bool:
    """Tell whether what is done with the value next knows None: `or`, a test, a function that takes it."""
    function = setting.function
    node: ast.AST = setting.read.node
    parent = function.up.get(node)
    while isinstance(parent, ast.Call) and called(parent) in _CONVERSIONS:
        node, parent = parent, function.up.get(parent)
    if isinstance(parent, (ast.BoolOp, ast.Compare, ast.UnaryOp, ast.IfExp, ast.If, ast.Call, ast.Return)):
        return True
    names = {ast.unparse(target) for target in targets(parent)} if isinstance(parent, ast.Assign) else set()
    tests = (
        entry
        for entry in function.nodes
        if isinstance(entry, (ast.Compare, ast.BoolOp, ast.If, ast.IfExp, ast.UnaryOp))
    )
    return any(
        ast.unparse(part) in names
        for entry in tests
        for part in ast.walk(entry)
        if isinstance(part, ast.expr) and entry.lineno > setting.read.node.lineno
    )
