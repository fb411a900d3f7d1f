"""XPL402: The environment client implements the task-environment interface."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl.environment import Environment
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ModelClass, symbols
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import dotted, parameters
from xpl_cli.standard import spec

_TASK_ENV = spec.data("package")["task_env"]
_MAKE: str = _TASK_ENV["maker"]
_BASE = f"{Environment.__module__}.{Environment.__name__}"
_SURFACE: dict[str, int] = _TASK_ENV["operations"]


@rule(code="XPL402", gate="static", requirement="XPL-ENV-2")
def env_interface(source: Source) -> Iterator[Finding]:
    """The client has no make(config), or the class that it returns lacks an operation that evaluation loops call.

    ## What it does
    Looks in the client file for `make`, finds the class that it returns, and compares that class's methods, inherited
    ones included, with the operations of a task environment. If the class cannot be determined, nothing is reported.

    ## Why it matters
    An evaluation loop calls these by name. A missing one is noticed at the first episode or, as with
    `get_running_env_idx_list`, only in batches.

    ## Example
    A client whose method is called `step` and not `take_action`.

    ## Use instead
    The interface of `envs/offline/client.py`, the smallest environment.

    ## Fix safety
    No automatic fix.
    """
    file = str(source.manifest_of("env.yml").get("client") or "client.py")
    source.tree(file)
    make = symbols(source, file).functions.get(_MAKE)
    if make is None:
        if _imports(source.tree(file), _MAKE):
            raise NotApplicable(f"{file} takes {_MAKE} from a package that is not part of the environment")
        yield Finding(
            f"{file} has no {_MAKE}: the evaluation cannot construct the environment",
            path=file,
            line=1,
            column=1,
            expected=f"def {_MAKE}(config)",
            got="no such function",
            fix=Fix("advice", f"define {_MAKE}(config), which returns the environment"),
        )
        return
    if not parameters(make.node):
        yield Finding(
            f"{_MAKE}() takes no configuration: task, robot and seeds cannot be chosen",
            **source.start(make.file, make.node),
            expected=f"def {_MAKE}(config)",
            got=f"def {_MAKE}()",
            fix=Fix("advice", "take the configuration, a dict"),
        )
    environment = _returned(source, make)
    if environment is None and _is_base(source, make):
        return
    if environment is None or not environment.is_closed:
        raise NotApplicable(f"the class that {_MAKE} returns cannot be determined without running it")
    missing = [name for name in _SURFACE if not environment.has(name)]
    if missing:
        yield Finding(
            f"the environment lacks {', '.join(missing)}: an evaluation loop that calls it stops",
            **source.start(environment.file, environment.node),
            expected=", ".join(_SURFACE),
            got=", ".join(sorted(environment.methods)),
            fix=Fix("advice", "write it, as envs/offline/client.py does"),
        )
    for name, most in _SURFACE.items():
        function = environment.method(name)
        if function is not None and function.node.args.vararg is None and len(parameters(function.node)) < most:
            yield Finding(
                f"{name} takes too few arguments: a loop that passes {most} stops with a TypeError",
                **source.start(function.file, function.node),
                expected=f"{most} arguments",
                got=f"def {name}({ast.unparse(function.node.args)})",
                fix=Fix("advice", "take them, with defaults"),
            )


def _is_base(source: Source, make: Function) -> bool:
    """Tell whether a function returns the SDK's own base of environments, which has the whole surface."""
    values = [node.value for node in make.nodes if isinstance(node, ast.Return) and node.value is not None]
    imported = {
        alias.asname or alias.name: f"{node.module}.{alias.name}"
        for node in source.tree(make.file).body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    made = [imported.get(dotted(value.func)) if isinstance(value, ast.Call) else None for value in values]
    return bool(made) and set(made) == {_BASE}


def _imports(tree: ast.Module, name: str) -> bool:
    return any(
        (alias.asname or alias.name) == name
        for node in tree.body
        for alias in getattr(node, "names", ())
        if isinstance(alias, ast.alias)
    )


def _returned(source: Source, make: Function) -> ModelClass | None:
    """Return the class that a function returns an object of: by its `return`, or by its annotation."""
    classes = symbols(source, make.file).classes
    values = [node.value for node in make.nodes if isinstance(node, ast.Return) and node.value is not None]
    made = {
        node.targets[0].id: node.value
        for node in make.nodes
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }
    returned = set()
    for value in values:
        origin = made.get(value.id, value) if isinstance(value, ast.Name) else value
        returned.add(dotted(origin.func) if isinstance(origin, ast.Call) else "")
    if len(returned) == 1 and (name := returned.pop()) in classes:
        return ModelClass.from_node(source, *classes[name])
    annotated = dotted(make.node.returns) if make.node.returns is not None else ""
    return ModelClass.from_node(source, *classes[annotated]) if annotated in classes else None
