"""XPL197: The loop ends when `is_episode_end()` says so."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.adapter import symbols
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.loops.functions import ENDS, does, loops
from xpl_cli.audit.static.loops.judge import goes_on_from
from xpl_cli.audit.static.loops.values import Unclear
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called

_END: Final = ENDS[0]


@rule(code="XPL197", requirement="XPL-LOOP-2")
def end_unasked(source: Source) -> Iterator[Finding]:
    """The loop does not ask `is_episode_end()`, and goes on for ever where nothing else tells the end.

    ## What it does
    Follows each function of deploy.py on its syntax tree through an episode whose end `is_episode_end()` alone tells:
    the list of running environments stays whole. Nothing is executed. A function that cannot be followed is looked
    through for the question instead, with the functions that it calls.

    ## Why it matters
    The ecosystem's debug client names all ten environments as running for ever. A batch that waits for that list to
    become empty never returns there: the first command that an integrator runs hangs, and so does every benchmark that
    ends a batch by a common step limit.

    ## Example
    `while running: ...; running = TASK_ENV.get_running_env_idx_list()`.

    ## Use instead
    `while running and not TASK_ENV.is_episode_end():`, and the same question after each action. `xpl update` brings it
    to adapters that were scaffolded with the older loop.

    ## Fix safety
    No automatic fix: `xpl update` merges the new loop with what its author changed.
    """
    unclear: list[str] = []
    for function in loops(source):
        try:
            place = goes_on_from(function, source)
        except Unclear as why:
            if any(_asks(one) for one in _reached(function, source)):
                unclear.append(f"{function.name} cannot be followed without running it: {why}")
                continue
            place = (function.file, function.node)
        if place is not None:
            yield Finding(
                f"{function.name} goes on for ever where {_END}() alone tells that the episode has ended: in the "
                "ecosystem's debug client it never returns",
                **source.start(*place),
                expected=f"a loop that ends when TASK_ENV.{_END}() is true",
                got=_asked_instead(function),
                fix=Fix("advice", "`xpl update` brings the loop that asks; or ask it where the list is asked"),
            )
    if unclear:
        raise NotApplicable("; ".join(unclear))


def _reached(function: Function, source: Source) -> list[Function]:
    """Return a function and those of its adapter that it calls, at any depth."""
    known = symbols(source, function.file).functions
    found = [function]
    for one in found:
        for call in one.of(ast.Call):
            other = known.get(called(call) or "")
            if other is not None and other not in found:
                found.append(other)
    return found


def _asks(function: Function) -> bool:
    return any(isinstance(node, ast.Attribute) and node.attr == _END for node in function.nodes)


def _asked_instead(function: Function) -> str:
    """Return what a function asks about the end of episodes."""
    asked = sorted(
        {str(call.func.attr) for call in does(function.node, function, ENDS) if isinstance(call.func, ast.Attribute)}
    )
    return f"one that asks {' and '.join(asked)}" if asked else "one that does not ask the environment"
