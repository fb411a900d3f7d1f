"""Pull-request templates: their fields, and those that a description leaves empty.

A template defines its fields in Markdown: a heading with text below it, `- Name:` with text after it, a checkbox, a
code block. Editing the template needs no change of code.
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
class FormSection:
    """The content below one heading.

    Attributes:
        fields: text after `- Name:`, by name.
        boxes: whether each checkbox is ticked, by its sentence.
        blocks: code blocks, stripped.
        words: all other lines that are not blank.
    """

    fields: dict[str, str] = field(default_factory=dict)
    boxes: dict[str, bool] = field(default_factory=dict)
    blocks: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)


def sections(text: str) -> dict[str, FormSection]:
    """Return the sections of a Markdown text by heading, without comments."""
    by_heading: dict[str, FormSection] = {}
    section = FormSection()  # text before the first heading is ignored
    lines = iter(_COMMENT.sub("", text.replace("\r\n", "\n")).split("\n"))
    for line in lines:
        text_line = " ".join(line.split())
        if heading := _HEADING.fullmatch(text_line):
            section = by_heading.setdefault(heading.group(1), FormSection())
        elif fence := _FENCE.match(text_line):
            section.blocks.append("\n".join(_fenced(lines, fence.group(1))).strip())
        elif box := _BOX.fullmatch(text_line):
            section.boxes[box.group(2)] = box.group(1) != " "
        elif entry := _FIELD.fullmatch(text_line):
            section.fields[entry.group(1)] = entry.group(2)
        elif text_line:
            section.words.append(text_line)
    return by_heading


def uses(text: str, form: str) -> bool:
    """Tell whether a text has one of a template's headings."""
    return bool(sections(text).keys() & sections(form).keys())


def unfilled_fields(text: str, form: str) -> Iterator[str]:
    """Yield the fields of a template that a text leaves empty, one sentence each."""
    answers = sections(text)
    for heading, template in sections(form).items():
        if heading not in answers:
            yield f"the section {heading!r} is missing"
            continue
        yield from _unfilled_of_section(heading, template, answers[heading])


def _unfilled_of_section(heading: str, template: FormSection, answer: FormSection) -> Iterator[str]:
    for name in template.fields:
        if not answer.fields.get(name):
            yield f"{heading}: {name!r} is not filled in"
    for sentence in template.boxes:
        if sentence not in answer.boxes:
            yield f"{heading}: the box {sentence!r} is missing"
        elif not answer.boxes[sentence]:
            yield f"{heading}: the box {sentence!r} is not ticked"
    if template.blocks and not any(answer.blocks):
        yield f"{heading}: the block of code is empty"
    is_free = not (template.fields or template.boxes or template.blocks)
    if is_free and not (answer.words or answer.fields or answer.boxes or answer.blocks):
        yield f"{heading}: the section is empty"


def _fenced(lines: Iterator[str], fence: str) -> Iterator[str]:
    """Yield the lines up to the end of a code block."""
    for line in lines:
        if line.strip().startswith(fence) and not line.strip().strip(fence[0]):
            return
        yield line
