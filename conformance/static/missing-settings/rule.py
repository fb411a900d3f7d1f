"""XPL167: What the model cannot do without is configured."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import LOADING, Adapter, Setting
from xpl_cli.audit.static.manifests import key_line
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import constant, enclosing, is_conditional
from xpl_cli.standard import spec


@rule(code="XPL167", requirement="XPL-CFG-10")
def missing_settings(source: Source) -> Iterator[Finding]:
    """The model asks for a key of the configuration that nobody sets.

    ## What it does
    Takes what the constructor reads as `config["key"]`, without a default, on every way through it, and looks for the
    key in `deploy.yml`, among the keys that launchers give, and in the adapter's scripts.

    ## Why it matters
    The server ends with a KeyError when the model is built, after the wait for a GPU. Whoever starts it has no list of
    what to give.

    ## Example
    `config["stats_path"]` in `load`, and no `stats_path` in `deploy.yml`.

    ## Use instead
    The key in `deploy.yml`, with its default or with `null` and a clear error where it is needed.

    ## Fix safety
    Adding the key with the value that was passed by hand changes nothing.
    """
    known = {str(key) for key in source.deploy} | set(spec.schema("deploy")["properties"])
    scripts = ""
    reported: set[str] = set()
    loading = {id(function.node) for function in Adapter.of(source).reach(*LOADING)}
    for setting in Adapter.of(source).settings:
        key = setting.read.key
        if not setting.read.required or key in known or key in reported or id(setting.function.node) not in loading:
            continue
        if _is_guarded(setting, key) or _is_set(source, key):
            continue
        scripts = scripts or "\n".join(source.text(name) for name in source.text_files if name.endswith(".sh"))
        if key in scripts:
            continue
        reported.add(key)
        near = key_line(source, sdk.File.DEPLOY_YML, sdk.Deploy.POLICY_NAME) if source.has(sdk.File.DEPLOY_YML) else 1
        yield Finding(
            f"nobody sets {key}: the server ends with a KeyError when it builds the model",
            **source.at(setting.function.file, setting.read.node),
            expected=f"{key} in {sdk.File.DEPLOY_YML}",
            got=ast.unparse(setting.read.node),
            evidence={"file": sdk.File.DEPLOY_YML, "line": near},
            fix=Fix("advice", f"add {key} to {sdk.File.DEPLOY_YML}, or read it with a default"),
        )


def _is_guarded(setting: Setting, key: str) -> bool:
    """Tell whether a read happens only where the key is there, or its failure is looked after."""
    function, node = setting.function, setting.read.node
    if is_conditional(node, function.node, function.up):
        return True
    if any(isinstance(entry, ast.Try) for entry in enclosing(node, function.up)):
        return True
    return any(
        isinstance(entry, ast.Compare) and isinstance(entry.ops[0], (ast.In, ast.NotIn)) and constant(entry.left) == key
        for entry in function.nodes
    )


def _is_set(source: Source, key: str) -> bool:
    """Tell whether code of the adapter puts a key into a map itself."""
    for file in source.python_files:
        for node in source.nodes(file) if source.parses(file) else ():
            if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store) and constant(node.slice) == key:
                return True
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                if node.func.attr == "setdefault" and node.args and constant(node.args[0]) == key:
                    return True
                if node.func.attr == "update" and any(entry.arg == key for entry in node.keywords):
                    return True
            if isinstance(node, ast.Dict) and any(constant(entry) == key for entry in node.keys if entry):
                return True
    return False
