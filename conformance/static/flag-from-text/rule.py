"""XPL117: A flag is never taken from the truth value of a text."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import Adapter, Setting
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called


@rule(code="XPL117", requirement="XPL-CFG-3")
def flag_from_text(source: Source) -> Iterator[Finding]:
    """A flag of the configuration goes through bool(), which takes the text "false" for true.

    ## What it does
    Follows the configuration through the constructor and the functions that get it, and looks for `bool(...)` around a
    value that is read from it.

    ## Why it matters
    An override on a command line arrives as text in many launchers. `bool("false")` and `bool("0")` are True, so that
    switching a feature off switches it on, and the run reports nothing.

    ## Example
    `self.delta = bool(config.get("delta", False))`.

    ## Use instead
    `self.setting("delta", False)` of `xpl.Policy`, which refuses a text where a flag is expected.

    ## Fix safety
    No automatic fix: what else may arrive is not known here.
    """
    found: dict[str, list[tuple[Setting, ast.Call]]] = {}
    for setting in Adapter.of(source).settings:
        call = setting.function.up.get(setting.read.node)
        if isinstance(call, ast.Call) and called(call) == "bool" and call.args == [setting.read.node]:
            found.setdefault(setting.function.file, []).append((setting, call))
    for file, uses in found.items():
        setting, call = uses[0]
        keys = list(dict.fromkeys(use.read.key for use, _ in uses))
        others = f", and likewise {', '.join(keys[1:])}" if keys[1:] else ""
        yield Finding(
            f'`{keys[0]}: "false"`, as an override arrives from a command line, switches {keys[0]} on{others}',
            **source.at(file, call),
            expected="a YAML boolean, and an error for anything else",
            got=ast.unparse(call),
            evidence={use.read.key: other.lineno for use, other in uses},
            fix=Fix("advice", f"self.setting({keys[0]!r}, False), or compare with True and False and raise otherwise"),
        )
