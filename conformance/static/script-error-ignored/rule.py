"""XPL156: A script ends with an error if one of its steps fails."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from xpl_cli.audit import Edit, Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.scripts.flow import (
    INSTALLERS,
    PYTHONS,
    STEPS,
    executed_words,
    program,
    quote_command,
    scripts,
    sourced_by,
    sources,
    word_location,
)
from xpl_cli.audit.static.shell import ShellCommand, ShellScript
from xpl_cli.audit.static.source import Source
from xpl_cli.standard import spec

_STOPS: Final = re.compile(r"stop|kill|clean|down|teardown")
_ASKED: Final = frozenset(("if", "elif", "while", "until", "!"))


@rule(code="XPL156", requirement="XPL-PKG-10")
def script_error_ignored(source: Source) -> Iterator[Finding]:
    """A script continues after a failed step, and ends with exit code 0.

    ## What it does
    Looks at the steps of each script: programs, installations, changes of the folder. Without `set -e` the script has
    to check every step but the last for failure. With it, the script has to check a step in a pipeline (`set -o
    pipefail`) and a step followed by `|| true` or `|| echo`, unless that only cleans up, tests or stops something. A
    script that others `source` has their options; a script that sources a library with `set -e` has that.

    ## Why it matters
    The launcher or job queue that runs the script sees success, although the environment is half installed, or the
    training stopped and left an old checkpoint. After a `cd` that failed, the next steps run in another folder.

    ## Example
    `pip install torch==2.4.1`, then `cd vendor && pip install -e .`, then `pip install -e .`, without `set -e`.

    ## Use instead
    `set -euo pipefail` at the beginning.

    ## Fix safety
    Unsafe: a script that used to continue after a harmless failure stops there.
    """
    has_finding = False
    for name, script in scripts(source):
        has_finding = True
        if _is_read(source, name):
            continue  # the options of the script that reads it hold
        if "errexit" in script.options or _shebang(source.text(name)) or _is_given(source, script):
            yield from _hidden(source, name, script)
        else:
            yield from _passed(source, name, script)
    if not has_finding:
        raise NotApplicable("the adapter has no scripts")


def _passed(source: Source, name: str, script: ShellScript) -> Iterator[Finding]:
    """Yield the first step of a script without `set -e` whose failure nobody looks at."""
    if any(command.name == "trap" and "ERR" in {word.text for word in command.words} for command in script):
        return
    passed = [number for number, command in enumerate(script) if _is_step(command) and _goes_on(script, number)]
    if not passed:
        return
    first = script[passed[0]]
    words = executed_words(first)
    others = f", and so are {len(passed) - 1} further steps" if len(passed) > 1 else ""
    yield Finding(
        f"a failure of `{quote_command(words, 3)}` is ignored{others}: {name} continues and may end with success",
        **word_location(name, words[0]),
        expected="set -euo pipefail before the first step",
        got="a script without set -e",
        evidence={"steps": [quote_command(executed_words(script[number]), 4) for number in passed]},
        fix=Fix("unsafe_edit", "set -euo pipefail", (_first(source, name, "set -euo pipefail"),)),
    )


def _hidden(source: Source, name: str, script: ShellScript) -> Iterator[Finding]:
    """Yield steps whose failure does not end a script with `set -e`: in a pipeline, or before `|| true`."""
    for number, command in enumerate(script):
        words = executed_words(command)
        if program(command) not in PYTHONS | INSTALLERS | {"bash", "sh"} or _is_asked(command):
            continue
        following = script[number + 1].name if number + 1 < len(script) else ""
        edits: tuple[Edit, ...] = ()
        if command.end == "|" and "pipefail" not in script.options:
            lost = f"a failure of `{quote_command(words, 3)}` is lost in the pipe to {following}"
            message = f"{lost}: {name} ends with success"
            expected = "set -o pipefail"
            edits = (_first(source, name, expected),)
        elif command.end == "||" and _only_tells(script[number + 1]) and not _may_fail(command):
            message = f"a failure of `{quote_command(words, 3)}` is ignored: {name} continues without its result"
            expected = f"the step without `|| {following}`"
            edits = _without(command, script[number + 1], name)
        else:
            continue
        yield Finding(
            message,
            **word_location(name, words[0]),
            expected=expected,
            got=f"{quote_command(words, 3)} {command.end} {following}",
            fix=Fix("unsafe_edit" if edits else "advice", expected, edits),
        )


def _only_tells(command: ShellCommand) -> bool:
    """Tell whether what runs in place of a failed step does nothing, or prints something, and the script goes on."""
    is_alone = command.end in {"", ";"} and not {"{", "("} & set(command.keywords)
    return command.name in {"true", ":"} or (command.name in {"echo", "printf"} and is_alone)


def _is_read(source: Source, name: str) -> bool:
    """Tell whether a script is a library: another one reads it by `source`, or it asks whether that is so."""
    is_standard = name in spec.data("package")["scripts"]
    asks = re.search(r"BASH_SOURCE\S*\s*[!=]=\s*\S*\$\{?0|\(return 0", source.text(name)) is not None
    return not is_standard and (asks or bool(sourced_by(source, name)))


def _is_given(source: Source, script: ShellScript) -> bool:
    """Tell whether a library that a script reads before its first step sets `errexit` for it."""
    steps = (
        number for number, command in enumerate(script) if _is_step(command) and command.name not in {"source", "."}
    )
    first = next(steps, len(script))
    return any("errexit" in library.options and number < first for number, library in sources(source, script))


def _may_fail(command: ShellCommand) -> bool:
    """Tell whether nothing lacks where a command failed: it cleans up, asks, or stops something."""
    words = [word.text for word in executed_words(command)]
    name, rest = program(command), words[1:]
    if name in {"conda", "mamba"} or {"uninstall", "remove", "cache", "check", "show", "list", "config"} & set(
        rest[:3]
    ):
        return True
    if name in {"bash", "sh"}:
        return any(_STOPS.search(word.rpartition("/")[2]) for word in rest[:2])
    return (
        name in PYTHONS and rest[:1] == ["-c"] and not re.search(r"\b(save|write|dump|download|train)", " ".join(rest))
    )


def _first(source: Source, name: str, text: str) -> Edit:
    """Return the edit that makes a command the first one of a script, behind the line that names its shell."""
    line = 2 if source.text(name).startswith("#!") else 1
    return Edit(name, line, 1, line, 1, f"{text}\n")


def _without(command: ShellCommand, alternative: ShellCommand, name: str) -> tuple[Edit, ...]:
    """Return the edit that deletes `|| true` behind a command on one line."""
    before, after = command.words[-1], alternative.words[0]
    if before.line != after.line or len(alternative.words) != 1:
        return ()
    return (Edit(name, before.line, before.column + len(before.raw), after.line, after.column + len(after.raw), ""),)


def _is_step(command: ShellCommand) -> bool:
    if program(command) not in STEPS or command.end in {"&", "|"} or _is_asked(command):
        return False
    return command.name != "exec"  # nothing comes after it


def _is_asked(command: ShellCommand) -> bool:
    return bool(_ASKED.intersection(command.keywords))


def _goes_on(script: ShellScript, number: int) -> bool:
    """Tell whether a script without `set -e` goes on after a step that failed."""
    while script[number].end == "&&":
        if number + 1 == len(script):
            return False
        number += 1
    if script[number].end == "||" or number + 1 == len(script):
        return False
    return not any("$?" in word.raw for word in script[number + 1].words)


def _shebang(text: str) -> bool:
    first = text.split("\n", 1)[0]
    return first.startswith("#!") and any(part.startswith("-") and "e" in part for part in first.split()[1:])
