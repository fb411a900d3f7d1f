"""XPL702: The adapter needs nothing of an observation that the standard does not have."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.model_class import ModelClass
from xpl_cli.audit.static.observation_flow import required_keys
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import texts
from xpl_cli.standard import spec


@rule(code="XPL702", requirement="XPL-OBS-1")
def foreign_observation_key(source: Source) -> Iterator[Finding]:
    """The adapter requires a key that observations of the standard do not have.

    ## What it does
    Follows observations from `update_obs` through the functions of the adapter, and compares the keys that they look up
    with `[...]` with those of the observation schema. Not reported: keys that the function tests for, or reads with
    `get`.

    ## Why it matters
    Every environment but the one that the author had answers with a KeyError: the adapter runs in no other benchmark.

    ## Example
    `observation["robot0_eef_pos"]`, or `observation["my_benchmark_state"]["joints"]`.

    ## Use instead
    The names of the standard (`observation["state"]["ee_pose"]`); what a benchmark has beyond them is read with `get`,
    from `additional_info`.

    ## Fix safety
    No automatic fix.
    """
    known = set(spec.schema("observation")["properties"])
    reported: set[str] = set()
    for function, node, key in required_keys(ModelClass.of(source)):
        if key in known or key in reported or _is_tested(function.of(ast.Compare, ast.Call), key):
            continue
        reported.add(key)
        yield Finding(
            f"an observation needs {key!r}, which no environment of the standard sends: update_obs fails elsewhere",
            **source.at(function.file, node),
            expected=f"one of {', '.join(sorted(known))}",
            got=ast.unparse(node),
            fix=Fix("advice", f"read it from {sdk.Obs.STATE} or {sdk.Obs.VISION} by its name in the standard"),
        )


def _is_tested(nodes: list[ast.AST], key: str) -> bool:
    """Tell whether a function asks for a key by `in` or `get` before."""
    asked: list[ast.expr] = []
    for node in nodes:
        if isinstance(node, ast.Compare) and any(isinstance(one, (ast.In, ast.NotIn)) for one in node.ops):
            asked.append(node.left)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "get":
            asked += node.args[:1]
    return any(key in texts(one) for one in asked)
