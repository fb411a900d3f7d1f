"""Helpers of rules for scripts: an adapter's scripts, the program of a command, variables that may be empty."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.static.shell import TESTS, ShellCommand, ShellScript, ShellWord

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.audit.rules.model import Location
    from xpl_cli.audit.static.source import Source

PYTHONS: Final = frozenset(("python", "python3", "torchrun", "accelerate", "deepspeed"))
SHELLS: Final = frozenset(("bash", "sh", "source", "."))
INSTALLERS: Final = frozenset(("pip", "pip3", "uv", "conda", "mamba"))
STEPS: Final = PYTHONS | SHELLS | INSTALLERS | {"cd", "git", "wget", "curl", "make", "cmake", "hf", "huggingface-cli"}
"""Programs on whose success later steps depend."""

_WRAPPERS: Final = frozenset(("exec", "env", "nohup", "setsid", "time", "sudo", "command", "stdbuf"))
_TESTS: Final = re.compile(r"(?:\[\[?|\btest)\s+(?:!\s+)?-[defrsx]\s")
_TESTED: Final = r"(?:\[\[?|\btest)\s+(?:!\s+)?-[defrsx]\s+[\"']?\$\{{?{}\b"
_LISTED: Final = re.compile(r"\bfor\s+(?P<item>\w+)\s+in\b|^\s*(?:local\s+|declare -a\s+)?(?P<array>\w+)\+?=\(")
_LONGEST_LIST: Final = 30
_PRINTS: Final = TESTS | {"echo", "printf", ":"}


def scripts(source: Source) -> Iterator[tuple[str, ShellScript]]:
    """Yield the shell scripts of the adapter's own folder with their commands."""
    for name in source.text_files:
        if name.endswith(".sh") and "/" not in name:
            yield name, source.commands(name)


def word_location(name: str, word: ShellWord) -> Location:
    """Return the location of a word, for a `Finding`."""
    return {"path": name, "line": word.line, "column": word.column}


def executed_words(command: ShellCommand) -> tuple[ShellWord, ...]:
    """Return the program that a command finally runs, with its arguments: without `exec` and `env NAME=value`."""
    words = command.arguments
    while words and words[0].text.rpartition("/")[2] in _WRAPPERS:
        words = words[1:]
        while words and (words[0].raw.startswith("-") or re.match(r"[A-Za-z_]\w*=", words[0].raw)):
            words = words[1:]
    return words


def program(command: ShellCommand) -> str:
    """Return the name of the program that a command finally runs; "" if it is a variable."""
    words = executed_words(command)
    return "" if not words or "$" in words[0].raw else words[0].text.rpartition("/")[2]


def quote_command(words: tuple[ShellWord, ...], limit: int = 6) -> str:
    """Return the start of a command, for a finding."""
    text = " ".join(word.raw for word in words[:limit])
    return (text if len(text) <= 80 else f"{text[:77]}...") + (" ..." if len(words) > limit else "")


def only_prints(command: ShellCommand) -> bool:
    """Return whether a command only prints or tests."""
    return command.name in _PRINTS


def may_be_empty(name: str, script: ShellScript) -> bool:
    """Return whether a variable that a script expands without a guard may be empty there.

    That is so if its value comes, unchecked, from an argument or from the environment, by an empty default, or from a
    folder that may not exist.
    """
    if name in _tested_variables(script):
        return False
    if name not in script.variables:
        return not name.isupper() or "nounset" not in script.options
    for command in script:
        for assigned, value in command.assignments:
            if assigned != name or not value.raw:
                continue
            is_empty_default = re.fullmatch(r"""["']?\$\{\w+:?-(?:""|'')?\}["']?""", value.raw) is not None
            is_argument = value.position is not None and not any(item.guard for item in value.expansions)
            is_folder = "$(cd " in value.raw and "errexit" not in script.options
            if is_empty_default or (is_argument and "nounset" not in script.options) or is_folder:
                return True
    return False


def _tested_variables(script: ShellScript) -> set[str]:
    """Return the variables that the script tests for being set."""
    names: set[str] = set()
    for command in script:
        for word in command.words:
            names.update(item.name for item in word.expansions if command.name in TESTS or "?" in item.guard)
    return names


def sourced_by(source: Source, name: str) -> list[str]:
    """Return the scripts of the adapter that `source` another one, by its file name."""
    return [
        other
        for other, commands in scripts(source)
        if other != name and any(_is_source_of(command, name) for command in commands)
    ]


def sources(source: Source, commands: ShellScript) -> Iterator[tuple[int, ShellScript]]:
    """Yield the scripts of the adapter that a script sources, with the index of the sourcing command."""
    for number, command in enumerate(commands):
        for name in source.text_files if command.name in {"source", "."} else ():
            if name.endswith(".sh") and "/" not in name and _is_source_of(command, name):
                yield number, source.commands(name)


def _is_source_of(command: ShellCommand, name: str) -> bool:
    words = command.arguments
    return command.name in {"source", "."} and len(words) > 1 and words[1].text.rpartition("/")[2] == name


def is_candidate(text: str, line: int) -> bool:
    """Return whether a path in a line of a script is only a candidate: used if a test finds it.

    Args:
        text: the script.
        line: 1-based; a list over several lines counts from the `for` or the name of the array that begins it.
    """
    lines = text.split("\n")
    here = lines[line - 1]
    if _TESTS.search(here):
        return True
    for start in range(line - 1, max(line - _LONGEST_LIST, -1), -1):
        head = _LISTED.search(lines[start])
        if head is None:
            continue
        variable = head.group("item")
        if head.group("array"):
            loop = re.search(rf"\bfor\s+(\w+)\s+in\s+[^\n]*\$\{{{head.group('array')}\[", text)
            variable = loop.group(1) if loop else None
        return variable is not None and re.search(_TESTED.format(re.escape(variable)), text) is not None
    return False
