"""Files that a script searches in several places, of which some do not depend on the checkpoint that was requested."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final, NamedTuple

from xpl import _spec as sdk

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.audit.static.source import Source

_LOOP: Final = re.compile(
    r"^[ \t]*for (?P<entry>\w+) in (?P<list>(?:[^;\n]|\\\n)+?);?\s*\n?\s*do\b(?P<body>.*?)^[ \t]*done\b",
    re.MULTILINE | re.DOTALL,
)
_ARRAY: Final = re.compile(r"\"?\$\{(\w+)\[@\]\}\"?")
_WORD: Final = re.compile(r"\"[^\"\n]*\"|[^\s\\()]+")
_ASSIGNMENT: Final = re.compile(r"^[ \t]*(?:local |export |readonly )?(\w+)=(.*)$", re.MULTILINE)
_EXPANSION: Final = re.compile(r"\$\{?(\w+)")
_ARGUMENT: Final = re.compile(r"[1-9]")


class ScriptedSubstitute(NamedTuple):
    """A place that is taken if the one that was requested is missing, or before it.

    Attributes:
        line: of the loop.
        requested: a place that depends on the checkpoint that was requested.
        other: one that does not.
    """

    file: str
    line: int
    requested: str
    other: str


def scripted_substitutes(source: Source) -> Iterator[ScriptedSubstitute]:
    """Yield the loops of scripts that take the first of several places which exists, asked for or not."""
    for name in source.text_files:
        if not name.endswith(".sh"):
            continue
        text = source.text(name)
        requested = _requested(text)
        for loop in _LOOP.finditer(text):
            if not re.search(rf"-[fde] +\"?\$\{{?{loop['entry']}\b", loop["body"]):
                continue
            places = _places(text, loop)
            wanted = [place for place in places if _depends(place, requested)]
            others = [place for place in places if "$" in place and not _depends(place, requested)]
            if wanted and others:
                yield ScriptedSubstitute(name, text.count("\n", 0, loop.start()) + 1, wanted[0], others[0])


def _places(text: str, loop: re.Match[str]) -> list[str]:
    """Return what a loop goes through: its words, or what is put into its array."""
    array = _ARRAY.fullmatch(loop["list"].strip())
    lists = [loop["list"]]
    if array is not None:
        filled = re.compile(rf"^[ \t]*(?:local )?{array[1]}\+?=\((.*?)\)", re.MULTILINE | re.DOTALL)
        lists = [found[1] for found in filled.finditer(text, 0, loop.start())]
    return [word.strip('"') for words in lists for word in _WORD.findall(words)]


def _requested(text: str) -> set[str]:
    """Return the variables that depend on the name of the checkpoint, and the arguments of functions."""
    found = {sdk.Deploy.CKPT_NAME}
    assignments = [(match[1], match[2]) for match in _ASSIGNMENT.finditer(text)]
    before = 0
    while before != len(found):
        before = len(found)
        found |= {name for name, value in assignments if _depends(value, found)}
    return found


def _depends(value: str, requested: set[str]) -> bool:
    return any(name in requested or _ARGUMENT.fullmatch(name) for name in _EXPANSION.findall(value))
