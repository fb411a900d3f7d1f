"""Find code of the adapter that reference.py uses: xpl, model.py, the model_io block.

An author can hide a use from this reader; recording also checks the imported modules. This finds unintended uses.
"""

from __future__ import annotations

import ast
import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli.model_io import names
from xpl_cli.model_io.reference_file import Import, SourceRange, parse_tree

if TYPE_CHECKING:
    from xpl_cli.audit.rules.model import Location
    from xpl_cli.audit.static.source import Source

_MODEL = sdk.File.MODEL_PY.removesuffix(".py")
_MOST_FILES = 5000


@dataclass(frozen=True)
class AdapterUse:
    """One use of the adapter by reference.py.

    Attributes:
        what: "xpl", "model.py" or "policy.yml".
        by: how it is used.
        location: its location, for a `Finding`.
    """

    what: str
    by: str
    location: Location


def adapter_uses(source: Source) -> Iterator[AdapterUse]:
    """Yield the uses of the adapter by reference.py, and by the package's own files that it imports."""
    for file in source.reached(names.CODE):
        if file == sdk.File.MODEL_PY or not source.parses(file):
            continue
        for item in parse_tree(source.tree(file)).imports:
            what = _imported_part(source, file, item)
            if what:
                yield AdapterUse(what, "imports", location_of(source, file, item.location))
        for node in source.nodes(file):
            text = node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""
            if text.rpartition("/")[2] == sdk.File.POLICY_YML:
                yield AdapterUse(sdk.File.POLICY_YML, "names the file of", source.at(file, node))


def location_of(source: Source, name: str, place: SourceRange) -> Location:
    """Return a place in a Python file as the location of a `Finding`."""
    node = ast.Pass(
        lineno=place.line, col_offset=place.column, end_lineno=place.end_line, end_col_offset=place.end_column
    )
    return source.at(name, node)


def _imported_part(source: Source, file: str, item: Import) -> str | None:
    """Return the part of the adapter that an import refers to, or None."""
    if item.takes_sdk:
        return "xpl"
    if item.level:
        is_root = item.level == file.count("/") + 1
        is_model = item.module == _MODEL or (not item.module and _MODEL in item.names)
        return sdk.File.MODEL_PY if is_root and is_model else None
    if item.takes_adapter(source.path.name):
        return sdk.File.MODEL_PY
    is_ours = item.module.partition(".")[0] == _MODEL and source.has(sdk.File.MODEL_PY)
    return sdk.File.MODEL_PY if is_ours and not _has_other_model_module(source) else None


def _has_other_model_module(source: Source) -> bool:
    """Return whether the package has another module `model`, such as that of the authors' code."""
    folders = ((folder, inner, files) for folder, inner, files in os.walk(source.path) if folder != str(source.path))
    return any(sdk.File.MODEL_PY in files or _MODEL in inner for _, inner, files in islice(folders, _MOST_FILES))
