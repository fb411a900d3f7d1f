"""XPL129: Paths are relative to the file, not to the working directory."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import LOADING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, last, names, parameters, targets

_RUNNERS = frozenset(("python", "python3", "bash", "sh", "source", ".", "torchrun"))

_MAKES = frozenset(("makedirs", "mkdir", "rmtree"))
_RELATIVE = re.compile(r"(?!/|~)(?:\.{1,2}/)?[\w.-]+(?:/[\w.-]+)*/?$")


@rule(code="XPL129", requirement="XPL-PKG-8")
def working_directory(source: Source) -> Iterator[Finding]:
    """A path depends on the working directory of the server or the script.

    ## What it does
    Looks for relative paths of the configuration that are resolved against the working directory, for folders that are
    created there, and for scripts that call a file of the adapter by a relative path without changing to its folder
    first.

    ## Why it matters
    Launchers start the server from their own folder. With the same deploy.yml the server finds the weights on one
    machine and not on the other, or finds other weights.

    ## Example
    `os.path.abspath(config["model_path"])`.

    ## Use instead
    `self.policy_dir / path`, which also accepts absolute paths; in scripts, `cd "$(dirname "${BASH_SOURCE[0]}")"`.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    config_parameters = _given(adapter)
    is_there = any(
        _goes_home(node) for file in source.python_files if source.parses(file) for node in source.nodes(file)
    )
    for function in () if is_there else adapter.reach(*LOADING):
        resolved = list(_resolved(function, config_parameters.get(id(function.node), set()), adapter))
        if resolved:
            paths = " and ".join(dict.fromkeys(path for _, path in resolved))
            yield _finding(source, function, resolved[0][0], f"{paths} of the configuration")
    yield from _scratch(source, adapter)
    for script in (sdk.File.PROCESS_DATA_SH, sdk.File.TRAIN_SH, sdk.File.EVAL_SH, sdk.File.SETUP_EVAL_POLICY_SERVER_SH):
        if source.has(script):
            yield from _called_by(source, script)


def _finding(source: Source, function: Function, node: ast.AST, path: str) -> Finding:
    return Finding(
        f"{path} depends on the working directory of the server: elsewhere it is not found, or is another file",
        **source.at(function.file, node),
        expected="a path that starts at the adapter's folder",
        got=ast.unparse(node),
        fix=Fix("advice", "join it to self.policy_dir, or to Path(__file__).parent"),
    )


def _goes_home(node: ast.AST) -> bool:
    """Tell whether a call makes a folder that is found by the file's own place the working directory."""
    return called(node) == "os.chdir" and any(
        isinstance(child, ast.Name) and (child.id == "__file__" or child.id.isupper() or child.id.startswith("_"))
        for child in ast.walk(node)
    )


def _given(adapter: ModelClass) -> dict[int, set[str]]:
    """Return, by function, the parameters that some caller fills with a value of the configuration."""
    reads = {id(setting.read.node) for setting in adapter.settings}
    config_parameters: dict[int, set[str]] = {}
    for function in adapter.reach(*LOADING):
        for node in function.nodes:
            other = adapter.callee(function, node) if isinstance(node, ast.Call) else None
            if other is not None and isinstance(node, ast.Call):
                for name, value in zip(parameters(other.node), node.args, strict=False):
                    if any(id(child) in reads for child in ast.walk(value)):
                        config_parameters.setdefault(id(other.node), set()).add(name)
    return config_parameters


def _resolved(function: Function, config_parameters: set[str], adapter: ModelClass) -> Iterator[tuple[ast.AST, str]]:
    """Yield values of the configuration that are made absolute by the working directory."""
    reads = {id(setting.read.node): setting.read.key for setting in adapter.settings}
    if any(
        last(called(node)) in {"isabs", "is_absolute", "join", "joinpath"} and names(node) & config_parameters
        for node in function.nodes
    ):
        return
    for node in function.nodes:
        if not isinstance(node, ast.Call):
            continue
        is_resolve = (
            isinstance(node.func, ast.Attribute) and node.func.attr in {"resolve", "absolute"} and not node.args
        )
        if last(called(node)) == "abspath" and node.args:
            value: ast.expr = node.args[0]
        elif is_resolve and isinstance(node.func, ast.Attribute) and "Path" in ast.unparse(node.func.value):
            value = node.func.value
        else:
            continue
        if any(
            isinstance(child, ast.BinOp) or last(called(child)) in {"join", "joinpath"} for child in ast.walk(value)
        ):
            continue
        for child in ast.walk(value):
            if id(child) in reads:
                yield node, reads[id(child)]
            elif isinstance(child, ast.Name) and child.id in config_parameters:
                yield node, child.id


def _scratch(source: Source, adapter: ModelClass) -> Iterator[Finding]:
    """Yield folders that the adapter makes for itself below the working directory, each once."""
    reported: set[str] = set()
    for function in adapter.reach(*adapter.methods):
        constants: dict[str, ast.Assign] | None = None
        for call in function.of(ast.Call):
            if last(called(call)) not in _MAKES:
                continue
            holder = call.func.value if isinstance(call.func, ast.Attribute) else None
            path_nodes = call.args[:1] if last(called(call)) != "mkdir" or holder is None else [holder]
            while (
                path_nodes and isinstance(path_nodes[0], ast.Call) and called(path_nodes[0]) in {"Path", "pathlib.Path"}
            ):
                path_nodes = path_nodes[0].args[:1]
            where: ast.AST = call
            value = path_nodes[0] if path_nodes else None
            if isinstance(value, ast.Name):
                constants = _constants(source, function.file) if constants is None else constants
                if value.id in constants:
                    where, value = constants[value.id], constants[value.id].value
            path = constant(value)
            if isinstance(path, str) and _RELATIVE.match(path) and path not in reported:
                reported.add(path)
                yield Finding(
                    f"{path} is created in the working directory of the server: two servers started there "
                    "overwrite each other's files",
                    **source.at(function.file, where),
                    expected="a folder of its own, from tempfile or the configuration",
                    got=ast.unparse(where).split("\n")[0],
                    fix=Fix("advice", "use tempfile.mkdtemp, or a folder from the configuration"),
                )


def _constants(source: Source, file: str) -> dict[str, ast.Assign]:
    """Return the constants of a module, by name."""
    return {
        target.id: node
        for node in source.tree(file).body
        if isinstance(node, ast.Assign)
        for target in targets(node)
        if isinstance(target, ast.Name)
    }


def _called_by(source: Source, script: str) -> Iterator[Finding]:
    """Yield calls of the adapter's own files by a relative path, before the script has gone anywhere."""
    for command in source.commands(script):
        if command.name in {"cd", "pushd"}:
            return
        words = [word for word in command.arguments if not word.text.startswith("-")]
        if len(words) > 1 and command.name in _RUNNERS:
            path = words[1]
            if not path.text.startswith(("/", "$", "~")) and "$" not in path.text and source.has(path.text):
                yield Finding(
                    f"{script} finds {path.text} only if it is started in the adapter's own folder",
                    path=script,
                    line=path.line,
                    column=path.column,
                    expected="a path from the script's folder",
                    got=path.text,
                    fix=Fix("advice", 'first cd "$(dirname "${BASH_SOURCE[0]}")"'),
                )
                return
