"""XPL137: Scripts take their positional arguments in the order of the standard."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.shell import ShellCommand, ShellWord
from xpl_cli.audit.static.source import Source
from xpl_cli.standard import spec

_ADDRESS: Final = re.compile(r"host|port|gpu|seed", re.IGNORECASE)
"""What a server has to be told by its script; other arguments may only label a run."""


@rule(code="XPL137", requirement="XPL-PKG-2")
def script_arguments(source: Source) -> Iterator[Finding]:
    """A script takes its positional arguments in another order than launchers pass them.

    ## What it does
    Parses the scripts and looks at `name=$N`: a variable with the name of an argument of the standard has to take it
    from that argument's position. Calls of the adapter's own scripts are checked in the same way, also by a variable
    that holds the script. An argument that the server's script takes and never uses is reported, too.

    ## Why it matters
    Launchers pass arguments by position. A script that expects the seed in the position of the action type evaluates
    the wrong thing, or saves its result under the wrong label.

    ## Example
    `seed=$5` in `eval.sh`, whose fifth argument is the action type.

    ## Use instead
    The order that `xpl spec show package` prints, which a fresh scaffold follows.

    ## Fix safety
    No automatic fix: callers of the script may have been adapted to it.
    """
    orders = {
        name: [entry.strip("[]") for entry in entries] for name, entries in spec.data("package")["scripts"].items()
    }
    for script, order in orders.items():
        if not source.has(script):
            continue
        for command in source.commands(script):
            if command.name == "shift":
                break
            yield from _taken(script, order, command)
        held = {name: word.text for command in source.commands(script) for name, word in command.assignments}
        for command in source.commands(script):
            for called, own_order in orders.items():
                yield from _given(script, called, own_order, command, held)
    yield from _unused(source, sdk.File.SETUP_EVAL_POLICY_SERVER_SH)


def _taken(script: str, order: list[str], command: ShellCommand) -> Iterator[Finding]:
    """Yield variables that take another argument than the one they are named after."""
    if command.functions:
        return  # a function's own arguments
    for variable, word in command.assignments:
        position = word.position
        name = variable.lower()
        if position is None or position < 1 or name not in order or order.index(name) + 1 == position:
            continue
        really = order[position - 1] if position <= len(order) else "nothing"
        yield _finding(script, word, f"{script} uses {really} as {name}", f"{variable}=${{{order.index(name) + 1}}}")


def _unused(source: Source, script: str) -> Iterator[Finding]:
    """Yield where the address that the script is given is not what the server gets."""
    if not source.has(script):
        return
    commands = source.commands(script)
    used = [command for command in commands if command.name not in {"echo", "printf"}]
    expanded = {item.name for command in used for word in command.words for item in word.expansions}
    for command in commands:
        for variable, word in command.assignments:
            if command.functions or not word.position or variable in expanded or not _ADDRESS.search(variable):
                continue
            yield _finding(
                script, word, f"{script} takes {variable} and never uses it", f"${{{variable}}} is passed on"
            )


def _given(
    script: str, called: str, own_order: list[str], command: ShellCommand, held: dict[str, str]
) -> Iterator[Finding]:
    """Yield arguments of a call of an own script that stand in the place of another one."""
    words = list(command.arguments)
    script_index = next(
        (
            number
            for number, word in enumerate(words)
            if f"/{held.get(word.variable or '', word.text)}".endswith(f"/{called}")
        ),
        None,
    )
    if script_index is None or script == called:
        return
    for word, expected in zip(words[script_index + 1 :], own_order, strict=False):
        variable = (word.variable or "").lower()
        if variable in own_order and variable != expected:
            yield _finding(
                script, word, f"{called} gets {variable} in the position of {expected}", f'"${{{expected}}}"'
            )


def _finding(script: str, word: ShellWord, consequence: str, expected: str) -> Finding:
    return Finding(
        f"{consequence}: the run differs from its label",
        path=script,
        line=word.line,
        column=word.column,
        expected=expected,
        got=word.raw,
        fix=Fix("command", "xpl spec show package"),
    )
