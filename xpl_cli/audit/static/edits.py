"""Edits of Python code for fixes."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING

from xpl_cli.audit.rules.model import Edit

if TYPE_CHECKING:
    from xpl_cli.audit.static.source import Source


def replace_node(source: Source, file: str, node: ast.AST, text: str) -> Edit:
    """Return the edit that replaces a node by a text."""
    at = source.at(file, node)
    return Edit(file, at["line"], at["column"], at["end_line"], at["end_column"], text)


def source_segment(source: Source, file: str, node: ast.AST) -> str:
    """Return a node as it is written in its file."""
    return ast.get_source_segment(source.text(file), node) or ast.unparse(node)


def same_quotes(source: Source, file: str, node: ast.AST, text: str) -> str:
    """Return a string literal with the same quotes as a literal of the file."""
    quote = "'" if source_segment(source, file, node).endswith("'") else '"'
    return f"{quote}{text}{quote}"
