"""Helpers of rules for YAML manifests: schema problems as findings, locations of keys, edits."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from xpl.nested import format_path
from xpl_cli.audit.rules.model import Edit, Finding, Fix, Location
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    import yaml

    from xpl_cli.audit.static.source import Source


def schema_findings(source: Source, name: str, schema: str, consequence: str) -> Iterator[Finding]:
    """Yield a finding for every way in which a YAML file differs from its schema.

    Args:
        source: the package.
        name: the file.
        schema: name of the schema.
        consequence: the consequence of a problem, with `{}` for its key or file.
    """
    from xpl_cli.standard.validate import validate_yaml_file

    for problem in validate_yaml_file(source.path / name, schema):
        yield Finding(
            f"{consequence.format(format_path(problem.path) or name)}: {problem.text.partition(': expected ')[0]}",
            path=name,
            line=problem.line,
            column=problem.column,
            expected=problem.expected,
            got=problem.got,
            fix=Fix("command", f"xpl spec show {schema}"),
        )


def key_line(source: Source, name: str, key: str) -> int:
    """Return the 1-based line of a top-level key of a YAML file, 1 if it is not found."""
    lines = source.text(name).split("\n")
    return next((number for number, text in enumerate(lines, start=1) if re.match(rf"{re.escape(key)}\s*:", text)), 1)


def location_in(source: Source, name: str, path: Sequence[str | int]) -> Location:
    """Return the location of a value of a YAML file: file, and 1-based line and column."""
    from xpl_cli.standard.validate import mark_of

    root = source.yaml_root(name)
    mark = None if root is None else mark_of(root, tuple(path))
    return {
        "path": name,
        "line": 1 if mark is None else mark.line + 1,
        "column": 1 if mark is None else mark.column + 1,
    }


def rename_fix(source: Source, name: str, key: str) -> Fix:
    """Return the fix that sets a top-level key of a YAML file to the name of the package's folder."""
    import json

    import yaml

    folder_name = source.path.name
    text = (
        folder_name
        if re.fullmatch(r"[A-Za-z_]\w*", folder_name) and isinstance(spec.parse_yaml(folder_name), str)
        else json.dumps(folder_name)
    )
    values = [value for _, value in _pairs(source.yaml_root(name), key) if isinstance(value, yaml.ScalarNode)]
    edits = tuple(
        Edit(name, start.line + 1, start.column + 1, end.line + 1, end.column + 1, text)
        for start, end in ((value.start_mark, value.end_mark) for value in values)
    )
    return Fix("safe_edit", f"{key}: {text}", edits)


def delete_edits(source: Source, name: str, keys: Collection[str]) -> Iterator[Edit]:
    """Yield the edits that delete top-level keys of a YAML file with all their lines."""
    lines = len(source.text(name).split("\n"))
    for key, value in _pairs(source.yaml_root(name), *keys):
        last = max(_lines(value))
        if last + 2 <= lines:
            yield Edit(name, key.start_mark.line + 1, 1, last + 2, 1, "")
        else:  # the last line of a file that does not end in a line break
            end = value.end_mark
            yield Edit(name, key.start_mark.line + 1, 1, end.line + 1, end.column + 1, "")


def _pairs(root: yaml.Node | None, *keys: str) -> list[tuple[yaml.Node, yaml.Node]]:
    """Return the entries of a mapping with one of these keys."""
    import yaml

    key_set = frozenset(keys)
    pairs = root.value if isinstance(root, yaml.MappingNode) else []
    return [(given, value) for given, value in pairs if isinstance(given, yaml.ScalarNode) and given.value in key_set]


def _lines(node: yaml.Node) -> Iterator[int]:
    """Yield the last lines of the values below a node of block style, which itself ends where the next one begins."""
    import yaml

    yield node.start_mark.line
    if isinstance(node, yaml.MappingNode):
        for pair in node.value:
            for child in pair:
                yield from _lines(child)
    elif isinstance(node, yaml.SequenceNode) and not node.flow_style:
        for child in node.value:
            yield from _lines(child)
    elif not isinstance(node, yaml.ScalarNode) or node.style not in ("|", ">"):
        yield node.end_mark.line
    else:
        yield node.end_mark.line - 1
