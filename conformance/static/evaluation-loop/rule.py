"""XPL133: deploy.py defines the two evaluation functions."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.loops import function_names, loops
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import parameters
from xpl_cli.standard import spec


@rule(code="XPL133", requirement="XPL-LOOP-1")
def evaluation_loop(source: Source) -> Iterator[Finding]:
    """deploy.py lacks an evaluation function, or a benchmark cannot call it.

    ## What it does
    Looks for `eval_one_episode` and `eval_one_episode_batch`, and checks that each takes the environment and the
    client.

    ## Why it matters
    A benchmark imports deploy.py, selects one of the two by `eval_batch`, and calls it with two arguments.

    ## Example
    A deploy.py without the batched function, because the author never needed it.

    ## Use instead
    Copy the function from a fresh scaffold: it does not depend on the policy.

    ## Fix safety
    No automatic fix.
    """
    name = sdk.File.DEPLOY_PY
    functions = {function.name: function for function in loops(source)}
    body = source.tree(name).body
    stars = [node for node in body if isinstance(node, ast.ImportFrom)]
    elsewhere = {alias.asname or alias.name for node in stars for alias in node.names}
    takes = spec.data("package")["loop"]["parameters"]
    assigned = {
        entry.id
        for node in body
        if isinstance(node, ast.Assign)
        for entry in node.targets
        if isinstance(entry, ast.Name)
    }
    for function_name in function_names():
        function = functions.get(function_name)
        if function is None:
            if function_name not in elsewhere | assigned and "*" not in elsewhere:
                yield Finding(
                    f"{name} does not define {function_name}: a benchmark that calls it stops with an AttributeError",
                    path=name,
                    line=1,
                    column=1,
                    expected=f"def {function_name}({', '.join(takes)})",
                    got="no such function",
                    fix=Fix("advice", "copy it from a fresh `xpl new-policy` scaffold"),
                )
            continue
        accepted = parameters(function.node)
        optional = len(function.node.args.defaults)
        if not len(accepted) - optional <= len(takes) <= len(accepted) and function.node.args.vararg is None:
            yield Finding(
                f"{function_name} takes {len(accepted)} arguments, and benchmarks call it with {len(takes)}: TypeError",
                **source.start(function.file, function.node),
                expected=f"def {function_name}({', '.join(takes)})",
                got=f"def {function_name}({ast.unparse(function.node.args)})",
                fix=Fix("advice", "take the environment and the client, in this order"),
            )
