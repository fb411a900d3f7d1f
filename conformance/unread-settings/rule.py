"""XPL120: What deploy.yml sets is read."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli import spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.source import Source
from xpl_cli.audit.syntax import texts


@rule(code="XPL120", slug="unread-settings", gate="static", requirement="XPL-CFG-4")
def unread_settings(source: Source) -> Iterator[Finding]:
    """deploy.yml sets keys that nobody reads.

    ## What it does
    Takes the adapter's own keys of `deploy.yml` and looks for each in the adapter's code and scripts. Where the whole
    configuration is handed on to another package, that package may read any key, and nothing is reported.

    ## Why it matters
    Whoever changes such a key sees no effect, and believes that there is none. Often it is a misspelt name of one that
    is read with its default.

    ## Example
    `include_state: false` in `deploy.yml`, and code that always includes it.

    ## Use instead
    Delete the key, or read it.

    ## Fix safety
    Deleting a key that nobody reads changes nothing.
    """
    adapter = source.adapter
    if adapter.config_escapes:
        raise NotApplicable("the whole configuration is handed on to another package, which may read any key")
    standard = set(spec.schema("deploy")["properties"])
    read = {text for name in source.python_files for text in _texts(source, name)}
    scripts = "\n".join(source.text(name) for name in source.text_files if name.endswith(".sh"))
    unread = [key for key in source.deploy if key not in standard and key not in read and str(key) not in scripts]
    if not unread:
        return
    lines = source.text(sdk.File.DEPLOY_YML).split("\n")
    line = next((number for number, text in enumerate(lines, start=1) if text.startswith(f"{unread[0]}:")), 1)
    yield Finding(
        f"nobody reads {', '.join(map(str, unread))}: changing {'it' if len(unread) == 1 else 'one of them'} has no effect",
        path=sdk.File.DEPLOY_YML,
        line=line,
        column=1,
        expected="a key that the adapter reads",
        got=str(unread[0]),
        fix=Fix("safe_edit", f"delete {', '.join(map(str, unread))}"),
    )


def _texts(source: Source, name: str) -> set[str]:
    """Return the texts of a Python file, and the names it reaches by attribute, as in `config.horizon`."""
    tree = source.tree(name)
    reached = (node for node in ast.walk(tree) if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load))
    return texts(tree) | {node.attr for node in reached if getattr(node.value, "id", "") != "self"}
