"""What rules about scripts share: the scripts of an adapter, what a command really runs, what a variable may hold."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.audit.static.shell import Command, Script, Word

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.audit.static.source import Source

PYTHONS: Final = frozenset(("python", "python3", "torchrun", "accelerate", "deepspeed"))
SHELLS: Final = frozenset(("bash", "sh", "source", "."))
INSTALLERS: Final = frozenset(("pip", "pip3", "uv", "conda", "mamba"))
STEPS: Final = PYTHONS | SHELLS | INSTALLERS | {"cd", "git", "wget", "curl", "make", "cmake", "hf", "huggingface-cli"}
"""Programs whose failure leaves what follows without what it needs."""

_WRAPPERS: Final = frozenset(("exec", "env", "nohup", "setsid", "time", "sudo", "command", "stdbuf"))
_TALK: Final = frozenset(("echo", "printf", "[", "[[", "test", ":"))


def scripts(source: Source) -> Iterator[tuple[str, Script]]:
    """Yield the shell scripts of the adapter's own folder with their commands."""
    for name in source.text_files:
        if name.endswith(".sh") and "/" not in name:
            yield name, script(source, name)


def script(source: Source, name: str) -> Script:
    """Return the commands of one script.

    Raises:
        NotRun: if there is no such file, or it is too large.
    """
    commands = source.commands(name)
    return commands if isinstance(commands, Script) else Script(commands)


def place(name: str, word: Word) -> dict[str, Any]:
    """Return where a word stands, for a `Finding`."""
    return {"path": name, "line": word.line, "column": word.column}


def runs(command: Command) -> tuple[Word, ...]:
    """Return the program that a command runs in the end, with its arguments: no `exec`, no `env NAME=value`."""
    words = command.arguments
    while words and words[0].text.rpartition("/")[2] in _WRAPPERS:
        words = words[1:]
        while words and (words[0].raw.startswith("-") or re.match(r"[A-Za-z_]\w*=", words[0].raw)):
            words = words[1:]
    return words


def program(command: Command) -> str:
    """Return the name of the program that a command runs in the end; "" where a variable holds it."""
    words = runs(command)
    return "" if not words or "$" in words[0].raw else words[0].text.rpartition("/")[2]


def shown(words: tuple[Word, ...], limit: int = 6) -> str:
    """Return the beginning of a command, to be quoted in a finding."""
    text = " ".join(word.raw for word in words[:limit])
    return (text if len(text) <= 80 else f"{text[:77]}...") + (" ..." if len(words) > limit else "")


def talks(command: Command) -> bool:
    """Tell whether a command only prints or tests, so that what it is given decides nothing else."""
    return command.name in _TALK or command.words[0].raw[0] == "-"


def may_be_empty(name: str, script: Script) -> bool:
    """Tell whether a variable that a script expands without a guard may hold nothing there.

    That is so if its value comes, unchecked, from an argument or from the environment, by an empty default, or from a
    folder that need not exist.
    """
    if name in _tested(script):
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


def _tested(script: Script) -> set[str]:
    """Return the variables that the script asks to hold something."""
    found: set[str] = set()
    for command in script:
        is_test = command.name in {"[", "[[", "test"} or command.words[0].raw[0] == "-"
        for word in command.words:
            found.update(item.name for item in word.expansions if is_test or "?" in item.guard)
    return found
