"""Forms: what a pull-request template asks for, and what of it a text leaves open.

A form says by its own Markdown what it wants: a heading with words below it, `- Name:` with words behind it, a box that
is ticked, a block of code that is filled in. So whoever edits the form needs to change no code.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

_COMMENT = re.compile(r"<!--.*?(-->|\Z)", re.DOTALL)
_HEADING = re.compile(r"#{2,6}\s+(.+)")
_BOX = re.compile(r"[-*+]\s+\[([ xX])\]\s+(.+)")
_FIELD = re.compile(r"[-*+]\s+([^:`]+):\s*(.*)")
_FENCE = re.compile(r"(`{3,}|~{3,})")


@dataclass
class Section:
    """What stands below one heading.

    Attributes:
        fields: names and what follows them.
        boxes: sentences, and whether they are ticked.
        blocks: blocks of code, without the blanks around them.
        words: everything else that is no blank line.
    """

    fields: dict[str, str] = field(default_factory=dict)
    boxes: dict[str, bool] = field(default_factory=dict)
    blocks: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)


def sections(text: str) -> dict[str, Section]:
    """Return the sections of a Markdown text by their headings; comments count as nothing."""
    found: dict[str, Section] = {}
    section = Section()  # what stands before the first heading is nobody's
    lines = iter(_COMMENT.sub("", text.replace("\r\n", "\n")).split("\n"))
    for line in lines:
        told = " ".join(line.split())
        if heading := _HEADING.fullmatch(told):
            section = found.setdefault(heading.group(1), Section())
        elif fence := _FENCE.match(told):
            section.blocks.append("\n".join(_fenced(lines, fence.group(1))).strip())
        elif box := _BOX.fullmatch(told):
            section.boxes[box.group(2)] = box.group(1) != " "
        elif named := _FIELD.fullmatch(told):
            section.fields[named.group(1)] = named.group(2)
        elif told:
            section.words.append(told)
    return found


def uses(text: str, form: str) -> bool:
    """Tell whether a text was begun with a form: it has one of its headings."""
    return bool(sections(text).keys() & sections(form).keys())


def open_places(text: str, form: str) -> Iterator[str]:
    """Yield what a text leaves open of a form, a sentence each."""
    answers = sections(text)
    for heading, asked in sections(form).items():
        if heading not in answers:
            yield f"the section {heading!r} is missing"
            continue
        yield from _open(heading, asked, answers[heading])


def _open(heading: str, asked: Section, given: Section) -> Iterator[str]:
    for name in asked.fields:
        if not given.fields.get(name):
            yield f"{heading}: {name!r} is not filled in"
    for sentence in asked.boxes:
        if sentence not in given.boxes:
            yield f"{heading}: the box {sentence!r} is gone"
        elif not given.boxes[sentence]:
            yield f"{heading}: the box {sentence!r} is not ticked"
    if asked.blocks and not any(given.blocks):
        yield f"{heading}: the block of code is empty"
    is_free = not (asked.fields or asked.boxes or asked.blocks)
    if is_free and not (given.words or given.fields or given.boxes or given.blocks):
        yield f"{heading}: nothing is said"


def _fenced(lines: Iterator[str], fence: str) -> Iterator[str]:
    """Yield the lines up to the end of a block of code."""
    for line in lines:
        if line.strip().startswith(fence) and not line.strip().strip(fence[0]):
            return
        yield line
