"""XPL170: Data conversion reads trajectories by the keys of the standard."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Edit, Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.edits import replace_node, same_quotes
from xpl_cli.audit.static.keys import LeafRead, closest_name, is_number, leaf_reads
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import constant, texts
from xpl_cli.standard import spec


@rule(code="XPL170", requirement="XPL-DAT-2")
def trajectory_names(source: Source) -> Iterator[Finding]:
    """Data conversion reads a key that trajectories do not have.

    ## What it does
    Follows in the Python files of the data conversion what is read below `vision`, `state` and `action`, through local
    variables, loops and HDF5 paths, and compares the last key with the trajectory schema. It reports keys that resemble
    one of the schema, unless the function also reads the right key and so supports both kinds of files.

    ## Why it matters
    A trajectory has a leading time axis and plural keys, an observation has singular ones. Reading the key of an
    observation ends the conversion with a KeyError, or, with `.get`, trains without the value.

    ## Example
    `episode["vision"]["cam_head"]["color"]` where the file holds `colors`.

    ## Use instead
    The keys that `xpl spec show trajectory` lists.

    ## Fix safety
    Safe: replaces the key by that of the standard.
    """
    if not source.conversion_files:
        raise NotApplicable("the adapter converts no data")
    schema = spec.schema("trajectory")
    series = tuple(schema["$defs"]["series"]["properties"])
    camera = tuple(schema["properties"][sdk.Obs.VISION]["additionalProperties"]["properties"])
    reported: set[int] = set()
    for file in source.conversion_files:
        for function in source.functions(file):
            for entry in leaf_reads(function):
                right = closest_name(entry.name, camera if entry.group == sdk.Obs.VISION else series)
                if right is not None and id(entry.node) not in reported and right not in texts(function.node):
                    reported.add(id(entry.node))  # a nested function is part of the one around it
                    yield _finding(source, file, entry, right)


def _finding(source: Source, file: str, entry: LeafRead, right: str) -> Finding:
    text = constant(entry.key)
    edits: tuple[Edit, ...] = ()
    if isinstance(text, str) and is_number(entry.name, right):
        edits = (replace_node(source, file, entry.key, same_quotes(source, file, entry.key, _renamed(text, right))),)
    what = (
        "the conversion ends with a KeyError"
        if entry.required
        else "it is never found, and training continues without it"
    )
    return Finding(
        f"trajectories have {right} and not {entry.name} below {entry.group}: {what}",
        **source.at(file, entry.key),
        expected=right,
        got=entry.name,
        fix=Fix("safe_edit" if edits else "advice", f"{right} in place of {entry.name}", edits),
    )


def _renamed(path: str, leaf: str) -> str:
    before, slash, _ = path.rpartition("/")
    return f"{before}{slash}{leaf}"
