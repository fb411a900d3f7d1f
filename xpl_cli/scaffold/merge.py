"""Three-way merge of text: the author's changes and the template's changes.

Lines that all three texts share align them. Between these, the side that changed something wins over the one that did
not; where both changed it differently, both are shown between conflict markers, as in git. Texts that would take too
long to compare become one conflict.
"""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

_OURS: Final = b"<<<<<<<"
_BASE: Final = b"|||||||"
_MIDDLE: Final = b"======="
_THEIRS: Final = b">>>>>>>"
_MOST_WORK: Final = 1 << 25
"""Limit on the estimated line comparisons of difflib, a few seconds; it searches again for each matching run."""


@dataclass(frozen=True)
class Merged:
    """The outcome of a merge.

    Attributes:
        content: the merged text.
        conflicts: number of conflicts, each between conflict markers.
    """

    content: bytes
    conflicts: int = 0


@dataclass(frozen=True)
class ConflictLabels:
    """Names of the three texts in conflict markers."""

    ours: str
    base: str
    theirs: str


def merge(base: bytes, ours: bytes, theirs: bytes, labels: ConflictLabels) -> Merged:
    """Merge two changes of one base; line ends are those of `ours`."""
    if b"\r\n" in ours and b"\r\n" not in theirs:
        merged = merge(base, ours.replace(b"\r\n", b"\n"), theirs, labels)
        return Merged(merged.content.replace(b"\n", b"\r\n"), merged.conflicts)
    texts = tuple(text.splitlines(keepends=True) for text in (base, ours, theirs))
    result: list[bytes] = []
    conflicts, ends = 0, (0, 0, 0)
    for starts, length in _shared(*texts):
        old, mine, new = (text[begin:end] for text, begin, end in zip(texts, ends, starts, strict=True))
        if mine in (old, new):
            result += new
        elif new == old:
            result += mine
        else:
            conflicts += 1
            result += _conflict(old, mine, new, labels)
        result += texts[0][starts[0] : starts[0] + length]
        ends = tuple(start + length for start in starts)  # type: ignore[assignment]
    return Merged(b"".join(result), conflicts)


def _shared(
    base: Sequence[bytes], ours: Sequence[bytes], theirs: Sequence[bytes]
) -> Iterator[tuple[tuple[int, int, int], int]]:
    """Yield the runs of lines that all three texts share: start in each, and length; the end as last one."""
    first, second = (_blocks(base, other) for other in (ours, theirs))
    one = other = 0
    while one < len(first) and other < len(second):
        mine, new = first[one], second[other]
        start = max(mine.a, new.a)
        end = min(mine.a + mine.size, new.a + new.size)
        if start < end:
            yield (start, mine.b + start - mine.a, new.b + start - new.a), end - start
        if mine.a + mine.size < new.a + new.size:
            one += 1
        else:
            other += 1
    yield (len(base), len(ours), len(theirs)), 0


def _blocks(base: Sequence[bytes], other: Sequence[bytes]) -> list[difflib.Match]:
    """Return the matching blocks of two texts and their end; only the end where matching would take too long."""
    one, two = Counter(base), Counter(other)
    shared = sum((one & two).values())
    pairs = sum(count * two[line] for line, count in one.items())
    if shared * (len(base) + pairs) > _MOST_WORK:
        return [difflib.Match(len(base), len(other), 0)]
    return difflib.SequenceMatcher(None, base, other, autojunk=False).get_matching_blocks()


def _conflict(
    old: Sequence[bytes], mine: Sequence[bytes], new: Sequence[bytes], labels: ConflictLabels
) -> Iterator[bytes]:
    """Yield the lines of a conflict."""
    for mark, label, lines in ((_OURS, labels.ours, mine), (_BASE, labels.base, old), (_MIDDLE, "", new)):
        yield b" ".join(filter(None, (mark, label.encode()))) + b"\n"
        yield from (line if line.endswith(b"\n") else line + b"\n" for line in lines)
    yield _THEIRS + b" " + labels.theirs.encode() + b"\n"
