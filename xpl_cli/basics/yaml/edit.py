"""Edits of a YAML map as text: whatever is not edited stays as its author wrote it, comments and order included."""

from __future__ import annotations

from typing import Any

import yaml

from xpl_cli.basics.yaml import text as yaml_text


class EditError(Exception):
    """A document that cannot be edited in this way; the argument says why."""


class Document:
    """A YAML map in block style, with edits of its top-level keys.

    Args:
        text: the document.

    Raises:
        EditError: if it is something else.
    """

    def __init__(self, text: str) -> None:
        self._newline = "\r\n" if "\r\n" in text else "\n"
        self.text = text.replace("\r\n", "\n")
        self._read()

    def result(self) -> str:
        """Return the text with the line ends that it came with."""
        return self.text.replace("\n", self._newline)

    def set(self, key: str, value: str) -> None:
        """Give a key that is there another scalar, written as in YAML.

        Raises:
            EditError: if the key is not there, or holds no scalar on one line.
        """
        node = next((value for name, value in self._pairs if name.value == key), None)
        if not isinstance(node, yaml.ScalarNode) or node.start_mark.line != node.end_mark.line:
            raise EditError(f"it has no key {key} with one value on its line")
        lines = self.text.split("\n")
        start, end = node.start_mark, node.end_mark
        line = lines[start.line]
        lines[start.line] = line[: start.column] + value + line[end.column :]
        self._replace("\n".join(lines))

    def add(self, key: str, block: str, after: str) -> None:
        """Add a key unless it is there.

        Args:
            key: the key.
            block: its whole lines.
            after: the key that it comes after; where that is missing, it goes to the end.
        """
        if key in self.data:
            return
        lines = self.text.split("\n")
        if lines[-1] == "":
            lines.pop()
        at = self._end_of(after, lines)
        lines[at:at] = block.rstrip("\n").split("\n")
        self._replace("\n".join(lines) + "\n")

    def _end_of(self, key: str, lines: list[str]) -> int:
        """Return the line behind a key and its value; what is commented out above the next key belongs to that."""
        names = [name.value for name, _ in self._pairs]
        place = names.index(key) if key in names else len(names) - 1
        if place + 1 < len(names):
            end: int = self._pairs[place + 1][0].start_mark.line
        else:
            mark = self._root.end_mark
            end = min(mark.line + (mark.column > 0), len(lines))
        first: int = self._pairs[place][0].start_mark.line
        while end - 1 > first and (not lines[end - 1].strip() or lines[end - 1].startswith("#")):
            end -= 1
        return end

    def _replace(self, text: str) -> None:
        self.text = text
        self._read()

    def _read(self) -> None:
        try:
            document = yaml_text.read(self.text)
        except yaml.YAMLError as error:
            raise EditError(f"it is not valid YAML: {' '.join(str(error).split())}") from None
        root = document.root
        if not isinstance(root, yaml.MappingNode) or root.flow_style:
            raise EditError("it is not a map with one key on a line")
        self._root = root
        self._pairs: list[tuple[Any, Any]] = root.value
        self.data: dict[str, Any] = document.data
