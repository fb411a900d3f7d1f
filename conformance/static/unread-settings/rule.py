"""XPL120: Every setting of deploy.yml is read."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.episode_state import is_reported
from xpl_cli.audit.static.keys import closest_name
from xpl_cli.audit.static.manifests import delete_edits
from xpl_cli.audit.static.model_class import ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, targets
from xpl_cli.standard import spec

_MOST_NAMED = 20
_SHORTEST = 6
"""Letters; shorter words, such as `name` or `type`, are part of too many keys."""
_CONVERSIONS = frozenset(("int", "float", "str", "bool", "list", "tuple"))


@rule(code="XPL120", requirement="XPL-CFG-4")
def unread_settings(source: Source) -> Iterator[Finding]:
    """deploy.yml sets keys that no code reads.

    ## What it does
    Takes the adapter's own keys of `deploy.yml` and looks for each in the adapter's code and scripts; a value that is
    only stored in an attribute, or printed, is not read. If the whole configuration is passed on to another package,
    that package may read any key, and nothing is reported; the helpers of the ecosystem read only keys of the standard.
    A key that code reads, that no file sets, and that abbreviates an unread key of the standard, is reported too.

    ## Why it matters
    A user who changes such a key sees no effect, and concludes that the setting has none. Often the key is misspelt,
    and the code uses the default of the right one.

    ## Example
    `include_state: false` in `deploy.yml`, and code that always includes it.

    ## Use instead
    Delete the key, or read it.

    ## Fix safety
    Deleting a key that no code reads changes nothing, but a misspelt one should be renamed.
    """
    adapter = ModelClass.of(source)
    if adapter.config_escapes:
        raise NotApplicable("the whole configuration is passed on to another package, which may read any key")
    standard = set(spec.schema("deploy")["properties"])
    read = {text for name in source.python_files if source.parses(name) for text in _texts(source, name)}
    scripts = "\n".join(source.text(name) for name in source.text_files if name.endswith(".sh"))
    unread = [key for key in source.deploy if key not in standard and key not in read and str(key) not in scripts]
    yield from _stored(source, adapter, standard)
    yield from _misnamed(source, adapter, standard, scripts)
    if not unread:
        return
    lines = source.text(sdk.File.DEPLOY_YML).split("\n")
    line = next((number for number, text in enumerate(lines, start=1) if text.startswith(f"{unread[0]}:")), 1)
    what = "it" if len(unread) == 1 else "one of them"
    yield Finding(
        f"no code reads {_named(unread)}: changing {what} has no effect",
        path=sdk.File.DEPLOY_YML,
        line=line,
        column=1,
        expected="a key that the adapter reads",
        got=str(unread[0]),
        fix=_deleted(source, unread),
    )


def _named(keys: list[str]) -> str:
    more = f" and {len(keys) - _MOST_NAMED} more" if len(keys) > _MOST_NAMED else ""
    return ", ".join(str(key) for key in keys[:_MOST_NAMED]) + more


def _deleted(source: Source, keys: list[str]) -> Fix:
    """Return the fix that deletes keys; it is unsafe, because a misspelt one should be renamed."""
    edits = tuple(delete_edits(source, sdk.File.DEPLOY_YML, [str(key) for key in keys]))
    text = f"delete {_named(keys)}, or rename them to the keys that the code reads"
    return Fix("unsafe_edit" if edits else "advice", text, edits)


def _texts(source: Source, name: str) -> set[str]:
    """Return the texts of a Python file, and the names it reaches by attribute, as in `config.horizon`."""
    words = set()
    for node in source.nodes(name):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            words.add(node.value)
        elif (
            isinstance(node, ast.Attribute)
            and isinstance(node.ctx, ast.Load)
            and getattr(node.value, "id", "") != "self"
        ):
            words.add(node.attr)
    return words


def _stored(source: Source, adapter: ModelClass, standard: set[str]) -> Iterator[Finding]:
    """Yield values of deploy.yml that end in an attribute which nothing uses but messages."""
    mentions: dict[str, int] = {}
    for file in source.python_files:
        for node in source.nodes(file) if source.parses(file) else ():
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
                mentions[node.attr] = mentions.get(node.attr, 0) + 1
    for setting in adapter.settings:
        statement: ast.AST = setting.read.node
        while isinstance(parent := setting.function.up.get(statement), ast.Call) and called(parent) in _CONVERSIONS:
            statement = parent
        is_own = setting.read.key in source.deploy and setting.read.key not in standard
        if not isinstance(parent, (ast.Assign, ast.AnnAssign)) or not is_own:
            continue
        for target in targets(parent):
            name = target.attr if isinstance(target, ast.Attribute) else ""
            if name and mentions.get(name, 0) == _reported(adapter, name) and not adapter.has(name):
                yield Finding(
                    f"{setting.read.key} is stored and never used: changing it has no effect",
                    **source.at(setting.function.file, parent),
                    expected=f"self.{name} has an effect",
                    got=ast.unparse(parent),
                    fix=Fix("advice", "use the value, or delete the key"),
                )


def _misnamed(source: Source, adapter: ModelClass, standard: set[str], scripts: str) -> Iterator[Finding]:
    """Yield keys that nobody sets, whose name is short for one of the standard that the adapter does not read."""
    read = {setting.read.key for setting in adapter.settings}
    written = {text for name in source.python_files if source.parses(name) for text in _texts(source, name)}
    reported: set[str] = set()
    for setting in adapter.settings:
        key = setting.read.key
        if source.deploy.get(key) is not None or key in standard or key in reported:
            continue
        meant = next((name for name in sorted(standard) if _is_short_for(key, name)), None)
        if meant is not None and meant not in read and meant not in written:
            reported.add(key)
            is_given = re.search(rf"(?<![\w/]){re.escape(key)}\b(?!/)", scripts) is not None
            who = "only the adapter's own scripts set it" if is_given else "nobody gives a value"
            yield Finding(
                f"{key} is read, to which {who}, and {meant}, which every launcher sets, is not: "
                f"{'without them' if is_given else 'so'} the adapter acts as if it had not been given",
                **source.at(setting.function.file, setting.read.node),
                expected=meant,
                got=key,
                fix=Fix("advice", f"read {meant}"),
            )


def _is_short_for(key: str, name: str) -> bool:
    """Tell whether a key is a misspelling of a name, or the name without its first or last word."""
    return closest_name(key, (name,)) == name or (
        len(key) >= _SHORTEST and (name.startswith(f"{key}_") or name.endswith(f"_{key}"))
    )


def _reported(adapter: ModelClass, name: str) -> int:
    """Return how often an attribute is mentioned only to be printed or logged."""
    return sum(
        is_reported(node, function)
        for function in adapter.reach(*adapter.methods)
        for node in function.nodes
        if isinstance(node, ast.Attribute) and node.attr == name and isinstance(node.ctx, ast.Load)
    )
