"""Where something stands in native.py, as a finding tells it."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from xpl_cli.audit.static.source import Source
    from xpl_cli.native.reading import Place


def standing(source: Source, name: str, place: Place) -> dict[str, Any]:
    """Return a place of a Python file for a `Finding`: file, and 1-based lines and columns counted in characters."""
    node = ast.Pass(
        lineno=place.line, col_offset=place.column, end_lineno=place.end_line, end_col_offset=place.end_column
    )
    return source.at(name, node)
