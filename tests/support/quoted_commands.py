"""The commands of `xpl` that texts tell: in fences, to be typed as they are, and in sentences, to be spoken of."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from tests.support import pages

_SHELL = frozenset({"console", "bash", "sh"})
_CALL = re.compile(r"(?:\./dev )?xpl (\S.*)")
_OPEN = frozenset({"...", "COMMAND"})
"""Words in the place of a command that stand for any."""

_UsageError: Any = typer.BadParameter.__base__


@dataclass(frozen=True)
class QuotedCommand:
    """A command as a text tells it.

    Attributes:
        words: what follows `xpl`.
        exact: whether it stands in a fence: then it must run as it is, but for names in capitals.
    """

    words: tuple[str, ...]
    exact: bool

    def __str__(self) -> str:
        return " ".join(["xpl", *self.words])


def quoted_commands(path: Path) -> list[QuotedCommand]:
    """Return the commands that a Markdown file of the checkout tells, each once."""
    entered = [
        words[words.index("xpl") + 1 :]
        for block in pages.blocks([path])
        if block.language in _SHELL
        for words in pages.shell(block.text)
        if words[0] == "xpl" or words[:2] == ["./dev", "xpl"]
    ]
    mentioned = [found[1].split() for span in pages.spans(path) if (found := _CALL.fullmatch(span))]
    quoted = [QuotedCommand(tuple(words), exact=words[0] not in _OPEN) for words in entered]
    quoted += [QuotedCommand(tuple(words), exact=False) for words in mentioned]
    return list(dict.fromkeys(quoted))


def command_error(command: QuotedCommand) -> str | None:
    """Return what the command line says against a command, or None."""
    try:
        return _fault_of_exact(command) if command.exact else _fault_of_spoken(command)
    except typer.Exit:  # --help and --version end there
        return None
    except _UsageError as error:
        return f"{command}: {error.format_message()}"


def _fault_of_exact(command: QuotedCommand) -> str | None:
    """Parse all of it; a number that stands in capitals is any number."""
    command_object, context, rest = pages._descend(list(command.words))
    if hasattr(command_object, "commands") and rest and not rest[0].startswith("-"):
        return f"{command}: there is no {rest[0]}"
    words = _with_numbers(command_object, context, rest)
    command_object.make_context(context.info_name, words, parent=context.parent)
    return None


def _with_numbers(command: Any, context: Any, words: list[str]) -> list[str]:
    """Return the words with a number where an option wants one and a name in capitals stands."""
    wanting = set()
    for parameter in command.get_params(context):
        kind = getattr(getattr(parameter, "type_descriptor", None), "annotation", None)
        wanting.update(parameter.opts if kind not in {bool, str, list[str]} else [])
    pairs = zip(["", *words], words, strict=False)
    return ["1" if before in wanting and word.isupper() else word for before, word in pairs]


def _fault_of_spoken(command: QuotedCommand) -> str | None:
    """Look up the command and its options; several may be told at once (`list|check`), and arguments may be missing."""
    words = [word.strip("[],") for word in itertools.takewhile(lambda word: word not in _OPEN, command.words)]
    for variant in itertools.product(
        *(word.split("|") if re.fullmatch(r"[a-z|-]+", word) else [word] for word in words)
    ):
        if unknown := pages.unknown(list(variant)):
            return f"{command}: there is no {unknown[0]}"
    return None
