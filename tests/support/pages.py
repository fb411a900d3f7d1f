"""The pages of the documentation: their fenced blocks, links and anchors, and the commands that they show."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import typer

from tests.support.checkout import ROOT, tracked
from xpl_cli.derived import commands, compiler, rules
from xpl_cli.main import app

DOCS = tracked("docs/**/*.md")
TOP = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
GENERATED = (compiler.REFERENCE, rules.FOLDER, commands.PAGE)
"""Pages that are written from something else, and cannot be wrong on their own."""

_FENCE = re.compile(
    r"(?:^<!-- (?P<mark>[^>]*?) -->\n+)?^(?P<indent> *)```(?P<language>\S*)(?P<info>[^\n]*)\n(?P<text>.*?)^ *```[ ]*$",
    re.MULTILINE | re.DOTALL,
)
_TITLE = re.compile(r'title="([^"]+)"')
_HEADING = re.compile(r"^#{1,6} +(.*?)\s*$", re.MULTILINE)
_LINK = re.compile(r"\]\(([^()\s]+)(?: \"[^\"]*\")?\)")
_LINKED = re.compile(r"\[([^]]*)\]\([^)]*\)")
_SPAN = re.compile(r"`([^`]+)`")
_ASSIGNMENT = re.compile(r"[A-Z_]+=")
_REDIRECTED = re.compile(r"\d?>\S+")


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes:
        page: its page, relative to the checkout.
        line: line of the page that opens it.
        language: what stands behind the fence.
        text: what it holds, without the fence's indentation.
        mark: the comment right above it, `runs` for instance.
        title: of the block: the file that it is, where it is one.
    """

    page: str
    line: int
    language: str
    text: str
    mark: str
    title: str = ""

    def __str__(self) -> str:
        """Return where it is."""
        return f"{self.page}:{self.line}"


def written() -> list[Path]:
    """Return the pages that people write."""
    return [path for path in (*TOP, *DOCS) if not str(path.relative_to(ROOT)).startswith(GENERATED)]


def blocks(paths: list[Path] | None = None) -> Iterator[Block]:
    """Yield every fenced block of some pages; of all that people write by default."""
    for path in written() if paths is None else paths:
        text = path.read_text(encoding="utf-8")
        for matches in _FENCE.finditer(text):
            line = text.count("\n", 0, matches.start("language")) + 1
            inner = re.sub(rf"^{matches['indent']}", "", matches["text"], flags=re.MULTILINE)
            title = _TITLE.search(matches["info"])
            yield Block(
                str(path.relative_to(ROOT)),
                line,
                matches["language"],
                inner,
                matches["mark"] or "",
                title[1] if title else "",
            )


def prose(path: Path) -> str:
    """Return a page without its fenced blocks."""
    return _FENCE.sub("", path.read_text(encoding="utf-8"))


def spans(path: Path) -> list[str]:
    """Return what stands in backticks, with single spaces."""
    return [" ".join(span.split()) for span in _SPAN.findall(prose(path))]


def links(path: Path) -> list[str]:
    """Return the targets of a page's links and pictures."""
    return _LINK.findall(_SPAN.sub("", prose(path)))


def anchors(path: Path) -> set[str]:
    """Return the anchors of a page's headings, as repositories on the web make them."""
    texts = (_LINKED.sub(r"\1", heading).lower() for heading in _HEADING.findall(prose(path)))
    names = Counter(re.sub(r"[^\w\- ]", "", text).replace(" ", "-") for text in texts)
    return {name if again == 0 else f"{name}-{again}" for name, count in names.items() for again in range(count)}


def entered(text: str) -> list[str]:
    """Return the lines of a shell example that one enters: where some begin with a prompt, the others are output."""
    lines = re.sub(r"\\\n\s*", "", text).splitlines()
    prompted = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
    return prompted or lines


def shell(text: str) -> list[list[str]]:
    """Return the commands of a shell example as words, without comments, variables and redirections.

    A pipe or `&&` ends one.
    """
    found: list[list[str]] = []
    for line in entered(text):
        words = shlex.shlex(line, posix=True, punctuation_chars="|&;")
        words.whitespace_split = True
        command: list[str] = []
        for word in words:
            if set(word) <= set("|&;"):
                found.append(command)
                command = []
            elif (command or not _ASSIGNMENT.match(word)) and not _REDIRECTED.fullmatch(word):
                command.append(word)
        found.append(command)
    return [command for command in found if command]


def parse(arguments: list[str]) -> Any:
    """Parse the words behind `xpl` as the command line does, and return the parsed command's context.

    Raises:
        Exception: one of the command line's library, if a command, an option or an argument is wrong or missing.
    """
    command, context, rest = _descend(arguments)
    if hasattr(command, "commands") and rest:
        raise typer.BadParameter(f"no command {rest[0]!r}")
    return command.make_context(context.info_name, [word for word in rest if word != "--help"], parent=context.parent)


def unknown(words: list[str]) -> list[str]:
    """Return what the words behind `xpl` name that is not there: a command, or options; arguments may be missing."""
    command, context, rest = _descend(words)
    if hasattr(command, "commands") and rest and not rest[0].startswith("-"):
        return rest[:1]
    options = {
        name for parameter in command.get_params(context) for name in (*parameter.opts, *parameter.secondary_opts)
    }
    return [word for word in rest if re.match(r"--?[a-z]", word) and word.partition("=")[0] not in options]


@cache
def command_line() -> Any:
    """Return the command line as its library has it."""
    return typer.main.get_command(app)


def _descend(words: list[str]) -> tuple[Any, Any, list[str]]:
    """Return the command that words lead to, a context for it, and the words behind its name."""
    command = command_line()
    context = command.make_context("xpl", [], resilient_parsing=True)
    while words and words[0] in getattr(command, "commands", {}):
        command = command.commands[words[0]]
        context = command.make_context(words[0], [], parent=context, resilient_parsing=True)
        words = words[1:]
    return command, context, words
