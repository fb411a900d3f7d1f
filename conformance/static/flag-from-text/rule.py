"""XPL117: A flag is never the truth value of a string."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.model_class import ConfigRead, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called


@rule(code="XPL117", requirement="XPL-CFG-3")
def flag_from_text(source: Source) -> Iterator[Finding]:
    """A flag of the configuration is converted by bool(), which returns True for the string "false".

    ## What it does
    Follows the configuration through the constructor and the functions that get it, and looks for `bool(...)` around a
    value of it.

    ## Why it matters
    Many launchers pass an override from the command line as a string. `bool("false")` and `bool("0")` are True, so
    switching a feature off switches it on, without an error.

    ## Example
    `self.delta = bool(config.get("delta", False))`.

    ## Use instead
    `self.setting("delta", False)` of `xpl.Policy`, which refuses a string where a flag is expected.

    ## Fix safety
    No automatic fix: the rule does not know which other values may arrive.
    """
    by_file: dict[str, list[tuple[ConfigRead, ast.Call]]] = {}
    for setting in ModelClass.of(source).settings:
        call = setting.function.up.get(setting.read.node)
        if isinstance(call, ast.Call) and called(call) == "bool" and call.args == [setting.read.node]:
            by_file.setdefault(setting.function.file, []).append((setting, call))
    for file, uses in by_file.items():
        setting, call = uses[0]
        keys = list(dict.fromkeys(use.read.key for use, _ in uses))
        others = f", and likewise {', '.join(keys[1:])}" if keys[1:] else ""
        yield Finding(
            f'`{keys[0]}: "false"`, an override from the command line, switches {keys[0]} on{others}',
            **source.at(file, call),
            expected="a YAML boolean, and an error for anything else",
            got=ast.unparse(call),
            evidence={use.read.key: other.lineno for use, other in uses},
            fix=Fix(
                "advice",
                (
                    f"self.setting({keys[0]!r}, False), or compare with True and False and raise an error for anything "
                    "else"
                ),
            ),
        )
