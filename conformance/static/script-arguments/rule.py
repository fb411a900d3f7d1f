"""XPL137: Scripts take their positional arguments in the order of the standard."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.shell import ShellCommand, ShellWord
from xpl_cli.audit.static.source import Source
from xpl_cli.standard import spec


@rule(code="XPL137", requirement="XPL-PKG-2")
def script_arguments(source: Source) -> Iterator[Finding]:
    """A script takes its positional arguments in another order than launchers pass them.

    ## What it does
    Parses the scripts and looks at `name=$N`: a variable with the name of an argument of the standard has to take it
    from that argument's position. Calls of the adapter's own scripts are checked in the same way, also by a variable
    that holds the script.

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
