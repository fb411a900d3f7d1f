"""Escape untrusted text, such as names, messages and evidence of a package, for each output format.

There is one function per format, and all untrusted text passes through one of them. The content stays readable: control
characters are escaped, and text that a platform would act upon is interrupted by a zero width space.
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
"""Control characters but tab and line end, direction marks, invisible characters, lone surrogates."""

_BETWEEN: Final = "\N{ZERO WIDTH SPACE}"
_LINKS: Final = re.compile(r"@|#(?=\d)|(?<=GH-)(?=\d)|(?<=://)|(?<=www\.)|(?<=mailto:)", re.IGNORECASE)
"""Prefixes of mentions, references and links on platforms such as GitHub."""
_MARKUP: Final = re.compile(r"(?<=\])(?=[(\[])|(?<=!)(?=\[)|(?<=<)(?=[\w!/?])")
_MARKDOWN: Final = re.compile(r"([\\`*_\[\]|~$])")
_ENTITIES: Final = str.maketrans({"<": "&lt;", ">": "&gt;", "&": "&amp;"})
"""Every dialect of Markdown reads these; a backslash before `<` only some of them."""
_MARKDOWN_FIRST: Final = re.compile(r"^(\d*)([#+\-=.)])")
_WORKFLOW: Final = re.compile(r"^(\s*):(?=:)|#(?=#\[)", re.MULTILINE)
"""Workflow commands of CI runners in printed output."""
_NO_XML: Final = re.compile("[\ufffe\uffff]")
_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r", "\N{FULLWIDTH EQUALS SIGN}", "\N{FULLWIDTH PLUS SIGN}",
                   "\N{FULLWIDTH HYPHEN-MINUS}", "\N{FULLWIDTH COMMERCIAL AT}")  # fmt: skip


def escape_controls(text: str) -> str:
    r"""Return a text with control characters escaped, such as `\u001b`; line ends stay.

    That form is also valid in JSON, with the same meaning.
    """
    return _CONTROLS.sub(_escape_code_units, text)


def one_line(text: str) -> str:
    """Return a text for a terminal or a log, on one line without workflow commands."""
    return without_workflow_commands(escape_controls(" ".join(text.split())))


def as_lines(lines: Iterable[str]) -> str:
    """Join lines for a terminal; line ends inside a line are escaped."""
    return "\n".join(escape_controls(line).replace("\n", "\\u000a") for line in lines)


def without_workflow_commands(text: str) -> str:
    """Return a text without workflow commands."""
    return _WORKFLOW.sub(lambda match: f"{match[1] or ''}\\u{ord(match[0][-1]):04x}", text)


def without_links(text: str) -> str:
    """Return a plain text without mentions, links and images, for viewers that may render it as Markdown."""
    return _LINKS.sub(lambda match: match[0] + _BETWEEN, _MARKUP.sub(_BETWEEN, escape_controls(text)))


def in_markdown(text: str) -> str:
    """Return a text that Markdown shows literally, on one line, without mentions."""
    called = _LINKS.sub(lambda match: match[0] + _BETWEEN, one_line(text))
    return _MARKDOWN_FIRST.sub(r"\1\\\2", _MARKDOWN.sub(r"\\\1", called)).translate(_ENTITIES)


def in_xml(text: str) -> str:
    """Return a text without the characters that XML 1.0 cannot represent, and without workflow commands."""
    return _NO_XML.sub("\N{REPLACEMENT CHARACTER}", without_workflow_commands(escape_controls(text)))


def in_table(value: object) -> object:
    """Return a table value that no spreadsheet takes for a formula; numbers stay numbers."""
    if not isinstance(value, str):
        return value
    return f"'{escape_controls(value)}" if value.lstrip(" \n").startswith(_FORMULA) else escape_controls(value)


def command(words: Iterable[str]) -> str:
    """Return a command for pasting into bash, on one line."""
    return " ".join(map(_quoted, words))


def _quoted(word: str) -> str:
    if "\n" not in word and "\t" not in word and _CONTROLS.search(word) is None:
        return shlex.quote(word)
    characters = (
        character if character.isprintable() and character not in "\\'" else _escaped(character) for character in word
    )
    return f"$'{''.join(characters)}'"


def _escaped(character: str) -> str:
    """Return a character escaped for `$'...'`."""
    if character in "\\'":
        return f"\\{character}"
    handler = "surrogateescape" if "\udc80" <= character <= "\udcff" else "surrogatepass"  # a byte, or half a pair
    return "".join(f"\\x{byte:02x}" for byte in character.encode(errors=handler))


def _escape_code_units(match: re.Match[str]) -> str:
    units = match[0].encode("utf-16-be", errors="surrogatepass")
    return "".join(f"\\u{units[index : index + 2].hex()}" for index in range(0, len(units), 2))
