"""What the rules about YAML manifests share: problems of the schema as findings, and the line of a key."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli import spec
from xpl_cli.audit.model import Edit, Finding, Fix

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.audit.source import Source


def schema_findings(source: Source, name: str, schema: str, consequence: str) -> Iterator[Finding]:
    """Yield a finding for every way in which a YAML file differs from its schema.

    Args:
        source: the package.
        name: the file.
        schema: name of the schema.
        consequence: what a problem means, with `{}` for the key or file it lies in.
    """
    from xpl_cli.problems import path_text
    from xpl_cli.validate import validate_yaml_file

    for problem in validate_yaml_file(source.path / name, schema):
        yield Finding(
            f"{consequence.format(path_text(problem.path) or name)}: {problem.message}",
            path=name,
            line=problem.line,
            column=problem.column,
            expected=problem.expected,
            got=problem.got,
            fix=Fix("command", f"xpl spec show {schema}"),
        )


def key_line(source: Source, name: str, key: str) -> int:
    """Return the 1-based line on which a top-level key of a YAML file stands, 1 if it is not found."""
    lines = source.text(name).split("\n")
    return next((number for number, text in enumerate(lines, start=1) if re.match(rf"{re.escape(key)}\s*:", text)), 1)


def renamed(source: Source, name: str, key: str) -> Fix:
    """Return the fix that gives a top-level key of a YAML file the name of the package's folder."""
    import json

    import yaml

    wanted = source.path.name
    text = (
        wanted
        if re.fullmatch(r"[A-Za-z_]\w*", wanted) and isinstance(spec.parse_yaml(wanted), str)
        else json.dumps(wanted)
    )
    root = yaml.compose(source.text(name), Loader=yaml.SafeLoader)
    pairs = root.value if isinstance(root, yaml.MappingNode) else []
    values = [value for given, value in pairs if given.value == key and isinstance(value, yaml.ScalarNode)]
    edits = tuple(
        Edit(name, start.line + 1, start.column + 1, end.line + 1, end.column + 1, text)
        for start, end in ((value.start_mark, value.end_mark) for value in values)
    )
    return Fix("safe_edit", f"{key}: {text}", edits)


def robots() -> frozenset[str]:
    """Return every name that stands for an embodiment of the standard, aliases included."""
    return frozenset(name for key, entry in sdk.EMBODIMENTS.items() for name in (key, *entry.get("aliases", ())))
