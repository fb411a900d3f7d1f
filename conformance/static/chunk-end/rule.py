"""XPL134: The evaluation loop stops executing a chunk when the episode ends."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Edit, Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.loops import ENDS, EXECUTES, environment_calls, loops, passes_on
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, dotted, enclosing, leaves, names, targets


@rule(code="XPL134", requirement="XPL-LOOP-2")
def chunk_end(source: Source) -> Iterator[Finding]:
    """The evaluation loop continues to execute a chunk after the episode has ended.

    ## What it does
    Takes the innermost loop around each `take_action` and checks that it stops at the end of the episode: in its own
    condition, or in a branch with `break` or `return`.

    ## Why it matters
    After success the arm continues to move and may undo it; an environment whose episode has ended may raise an error,
    or count the steps for the next episode.

    ## Example
    `for action in chunk: TASK_ENV.take_action(action)`, with the check only around the whole chunk.

    ## Use instead
    `if TASK_ENV.is_episode_end(): break` after each action.

    ## Fix safety
    Safe: the check changes nothing before the end of an episode. It is added if the action of one environment is a
    statement of its own in a `for` over the chunk; the author has to fix other loops.
    """
    for function in loops(source):
        for call in environment_calls(function.node, function, EXECUTES):
            loop = next(
                (entry for entry in enclosing(call, function.up) if isinstance(entry, (ast.For, ast.While))), None
            )
            if loop is None or passes_on(loop, function, source, 0, ENDS):
                continue
            if call.func.attr == EXECUTES[1] and _ends(loop, function) and not _knows_running(loop, function):
                yield Finding(
                    f"{function.name} steps environments whose episode has ended until the chunk is over, as long as "
                    "another one runs: their success may be undone",
                    **source.at(function.file, call),
                    expected=f"{ENDS[1]}() after each action, and only those that run in the next one",
                    got=f"{ast.unparse(loop).splitlines()[0]} without it",
                    fix=Fix("advice", f"update the list of environments by {ENDS[1]}() inside the chunk"),
                )
                break
            if not _ends(loop, function):
                yield Finding(
                    f"{function.name} continues the chunk after the episode has ended: success may be undone",
                    **source.at(function.file, call),
                    expected="a check of is_episode_end() after each action, and a break",
                    got=f"{ast.unparse(loop).splitlines()[0]} without one",
                    fix=_fix(source, function, call, loop),
                )
                break


def _knows_running(loop: ast.For | ast.While, function: Function) -> bool:
    """Tell whether a loop over a chunk asks which environments still run."""
    return any(environment_calls(loop, function, (ENDS[1],)))


def _fix(source: Source, function: Function, call: ast.Call, loop: ast.For | ast.While) -> Fix:
    """Return the check after the action, as an edit where it is certain where that belongs."""
    environment = dotted(call.func).rpartition(".")[0] or "TASK_ENV"
    text = f"if {environment}.is_episode_end(): break"
    statement = next((entry for entry in loop.body if isinstance(entry, ast.Expr) and entry.value is call), None)
    if (
        statement is None
        or not isinstance(loop, ast.For)
        or loop.orelse
        or called(call) != f"{environment}.{EXECUTES[0]}"
    ):
        return Fix("advice", text)
    at = source.at(function.file, statement)
    lines = source.text(function.file).split("\n")
    before = lines[at["line"] - 1][: at["column"] - 1]
    last_line = lines[at["end_line"] - 1]
    if before.strip() or last_line[at["end_column"] - 1 :].lstrip().startswith(";"):
        return Fix("advice", text)
    end = len(last_line) + 1
    added = f"\n{before}if {environment}.is_episode_end():\n{before}    break"
    return Fix("safe_edit", text, (Edit(function.file, at["end_line"], end, at["end_line"], end, added),))


def _ends(loop: ast.For | ast.While, function: Function) -> bool:
    """Tell whether a loop asks for the end of the episode and leaves."""
    if isinstance(loop, ast.While) and any(environment_calls(loop.test, function, ENDS)):
        return True
    end_flags: set[str] = set()  # names that hold whether the episode has ended
    for node in ast.walk(loop):
        if isinstance(node, ast.Assign) and (
            any(environment_calls(node.value, function, ENDS)) or names(node.value) & end_flags
        ):
            end_flags |= {target.id for target in targets(node) if isinstance(target, ast.Name)}
    for node in ast.walk(loop):
        if isinstance(node, ast.If):
            asks = any(environment_calls(node.test, function, ENDS)) or bool(names(node.test) & end_flags)
            if asks and (leaves(node.body) or leaves(node.orelse)):
                return True
            if asks and any(called(child) in {f"{name}" for name in EXECUTES} for child in ast.walk(node)):
                return True
    return isinstance(loop, ast.While) and bool(names(loop.test) & end_flags)
