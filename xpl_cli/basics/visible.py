"""Text of strangers, fit to be shown: what would move a cursor, colour a terminal or forge a line is written out."""

from __future__ import annotations


def visible(text: str) -> str:
    r"""Return a text on one line, with everything that is not printed written out, such as `\n`, `\x1b` or `\u202e`.

    Control characters, line separators, marks of writing direction, characters without width and lone surrogates count.
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode("ascii") for char in text)
