"""Text of strangers: names, messages and evidence that a package brings, made harmless for each place that shows them.

One function for each place, and nothing of a stranger's is shown without. What is taken from a text is its power over
its reader, never its content: characters that steer are written out, and what a platform would act upon is interrupted
by a space of no width.
"""

from __future__ import annotations

import re
import shlex
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

_CONTROLS: Final = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\ud800-\udfff\U000e0000-\U000e007f]"
)
"""Control characters but tab and line end, marks of writing direction, what is invisible, halves of surrogate pairs."""

_BETWEEN: Final = "\N{ZERO WIDTH SPACE}"
_LINKS: Final = re.compile(r"@|#(?=\d)|(?<=GH-)(?=\d)|(?<=://)|(?<=www\.)|(?<=mailto:)", re.IGNORECASE)
"""Behind these a platform reads whom to notify, what to refer to, where to link to."""
_MARKUP: Final = re.compile(r"(?<=\])(?=[(\[])|(?<=!)(?=\[)|(?<=<)(?=[\w!/?])")
_MARKDOWN: Final = re.compile(r"([\\`*_\[\]|~$])")
_ENTITIES: Final = str.maketrans({"<": "&lt;", ">": "&gt;", "&": "&amp;"})
"""Every dialect of Markdown reads these; a backslash before `<` only some of them."""
_MARKDOWN_FIRST: Final = re.compile(r"^(\d*)([#+\-=.)])")
_WORKFLOW: Final = re.compile(r"^(\s*):(?=:)|#(?=#\[)", re.MULTILINE)
"""What the runner of a workflow takes for a command, in whatever is printed."""
_NO_XML: Final = re.compile("[\ufffe\uffff]")
_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r", "\N{FULLWIDTH EQUALS SIGN}", "\N{FULLWIDTH PLUS SIGN}",
                   "\N{FULLWIDTH HYPHEN-MINUS}", "\N{FULLWIDTH COMMERCIAL AT}")  # fmt: skip


def escape_controls(text: str) -> str:
    r"""Return a text with whatever would steer its reader's screen written out as `\u001b`; line ends stay.

    That form is also valid in JSON, where it means the same text.
    """
    return _CONTROLS.sub(_escape_code_units, text)


def one_line(text: str) -> str:
    """Return a text for a terminal or a log, on one line that is no command of a workflow."""
    return without_workflow_commands(escape_controls(" ".join(text.split())))


def as_lines(lines: Iterable[str]) -> str:
    """Return lines as one text for a terminal, in which no name of a line makes another one."""
    return "\n".join(escape_controls(line).replace("\n", "\\u000a") for line in lines)


def without_workflow_commands(text: str) -> str:
    """Return a text of which no line is a command for the runner of a workflow."""
    return _WORKFLOW.sub(lambda found: f"{found[1] or ''}\\u{ord(found[0][-1]):04x}", text)


def without_links(text: str) -> str:
    """Return a text for what shows plain texts as Markdown at times: it names nobody, links nowhere, shows no image."""
    return _LINKS.sub(lambda found: found[0] + _BETWEEN, _MARKUP.sub(_BETWEEN, escape_controls(text)))


def in_markdown(text: str) -> str:
    """Return a text that Markdown shows as it is, on one line, and that calls nobody by name."""
    called = _LINKS.sub(lambda found: found[0] + _BETWEEN, one_line(text))
    return _MARKDOWN_FIRST.sub(r"\1\\\2", _MARKDOWN.sub(r"\\\1", called)).translate(_ENTITIES)


def in_xml(text: str) -> str:
    """Return a text without the characters that XML 1.0 has no way to write; a log may show it line by line."""
    return _NO_XML.sub("\N{REPLACEMENT CHARACTER}", without_workflow_commands(escape_controls(text)))


def in_table(value: object) -> object:
    """Return a value of a table of which no spreadsheet makes a formula; numbers stay numbers."""
    if not isinstance(value, str):
        return value
    return f"'{escape_controls(value)}" if value.lstrip(" \n").startswith(_FORMULA) else escape_controls(value)


def command(words: Iterable[str]) -> str:
    """Return a command to be pasted into bash, on one line whatever its words hold."""
    return " ".join(map(_quoted, words))


def _quoted(word: str) -> str:
    if "\n" not in word and "\t" not in word and _CONTROLS.search(word) is None:
        return shlex.quote(word)
    letters = (letter if letter.isprintable() and letter not in "\\'" else _escaped(letter) for letter in word)
    return f"$'{''.join(letters)}'"


def _escaped(letter: str) -> str:
    """Return a character as it is written between `$'` and `'`."""
    if letter in "\\'":
        return f"\\{letter}"
    handler = "surrogateescape" if "\udc80" <= letter <= "\udcff" else "surrogatepass"  # a byte, or half a pair
    return "".join(f"\\x{byte:02x}" for byte in letter.encode(errors=handler))


def _escape_code_units(found: re.Match[str]) -> str:
    units = found[0].encode("utf-16-be", errors="surrogatepass")
    return "".join(f"\\u{units[place : place + 2].hex()}" for place in range(0, len(units), 2))
