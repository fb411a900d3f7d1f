"""XPL163: In a batch every environment executes its own chunk, also after others have ended."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.loops.functions import ENDS, EXECUTES, around, chunks, does, hands_on, loops
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, last, names, targets

_BATCH, _RUNNING = EXECUTES[1], ENDS[1]


@rule(code="XPL163", requirement="XPL-LOOP-6")
def chunks_out_of_step(source: Source) -> Iterator[Finding]:
    """After an environment has ended, the others execute chunks that are not theirs.

    ## What it does
    Takes the loop around each `take_action_batch` and follows the list of environments and the list of chunks. Where
    the former shrinks, the latter has to shrink with it, or be looked up by environment. A list that came from the
    policy is in the order of the request, and not indexed by the environment's number. Where the former never shrinks
    inside a chunk, environments that have ended are moved on.

    ## Why it matters
    Nothing fails: environment 3 executes what was meant for environment 2. Success of a batch drops, and that of the
    same policy one by one does not.

    ## Example
    `running = TASK_ENV.get_running_env_idx_list()` inside the chunk, and `[chunk[step] for chunk in answer]` after it.

    ## Use instead
    `chunks = {env: answer[place] for place, env in enumerate(running)}`, as in a fresh scaffold.

    ## Fix safety
    No automatic fix.
    """
    for function in loops(source):
        answered = chunks(function)
        for call in does(function.node, function, (_BATCH,)):
            loop = around(call, function)
            if loop is not None and len(call.args) + len(call.keywords) > 1:
                yield from _judged(source, function, call, loop, answered)


def _judged(
    source: Source, function: Function, call: ast.Call, loop: ast.For | ast.While, answered: set[str]
) -> Iterator[Finding]:
    inside = list(ast.walk(loop))
    given = [*call.args, *(keyword.value for keyword in call.keywords)]
    actions, listed = given[0], names(given[1])
    set_here = {name for node in inside for target in targets(node) for name in _own(target)}
    for _ in range(2):  # `current = [...]` stands for what it is made of
        if isinstance(actions, ast.Name):
            actions = _value(actions.id, inside) or actions
    if isinstance(loop, ast.For) and any(call in ast.walk(node) for node in ast.walk(loop.iter)):
        return
    by_number = next(_by_number(actions, listed, answered, inside), None)
    if by_number is not None:
        yield Finding(
            f"{function.name} takes environment 9's chunk from place 9 of an answer in the order of the request",
            **source.at(function.file, by_number),
            expected="the place of the environment in the list that was asked for",
            got=ast.unparse(by_number),
            fix=Fix("advice", "chunks = {env: answer[place] for place, env in enumerate(running)}"),
        )
        return
    kept = sorted(_positional(actions) & (answered | set_here) - set_here)
    if listed & set_here and kept:
        yield Finding(
            f"{function.name} executes another environment's chunk once one has ended: {kept[0]} keeps its order",
            **source.at(function.file, call),
            expected=f"{kept[0]} shortened with the list of environments, or looked up by environment",
            got=ast.unparse(actions)[:80],
            fix=Fix("advice", "chunks = {env: answer[place] for place, env in enumerate(running)}"),
        )
    is_fixed = not listed & set_here and isinstance(loop, ast.For) and bool(listed)
    if is_fixed and not hands_on(loop, function, source, 0) and not any(does(loop, function, (_RUNNING,))):
        yield Finding(
            f"{function.name} goes on moving environments that have ended while others in the batch run",
            **source.at(function.file, call),
            expected=f"{_RUNNING}() after each action",
            got=ast.unparse(call)[:80],
            fix=Fix("advice", "ask for the running environments after each action, as a fresh scaffold does"),
        )


def _own(target: ast.AST) -> Iterator[str]:
    if isinstance(target, ast.Name):
        yield target.id


def _value(name: str, nodes: list[ast.AST]) -> ast.expr | None:
    return next(
        (
            node.value
            for node in nodes
            if isinstance(node, ast.Assign) and any(isinstance(to, ast.Name) and to.id == name for to in targets(node))
        ),
        None,
    )


def _positional(actions: ast.AST) -> set[str]:
    """Return the lists that an expression goes through from the first to the last, or by running number."""
    found: set[str] = set()
    for node in ast.walk(actions):
        if not isinstance(node, ast.ListComp):
            continue
        source = node.generators[0].iter
        numbers: set[str] = set()
        if isinstance(source, ast.Name):
            found.add(source.id)
        elif isinstance(source, ast.Call) and last(called(source)) in {"enumerate", "zip"}:
            found |= {argument.id for argument in source.args if isinstance(argument, ast.Name)}
            counter = node.generators[0].target
            if called(source) == "enumerate" and isinstance(counter, ast.Tuple):
                numbers = names(counter.elts[0])
        elif isinstance(source, ast.Call) and called(source) == "range":
            numbers = names(node.generators[0].target)
        found |= {
            child.value.id
            for child in ast.walk(node.elt)
            if isinstance(child, ast.Subscript) and isinstance(child.value, ast.Name) and names(child.slice) & numbers
        }
    return found


def _by_number(
    actions: ast.AST, listed: set[str], answered: set[str], inside: list[ast.AST]
) -> Iterator[ast.Subscript]:
    """Yield places of the policy's answer that are looked up by the number of an environment."""
    again = {name for node in inside for target in targets(node) for name in _own(target)}
    for node in ast.walk(actions):
        through = node.generators[0] if isinstance(node, ast.ListComp) else None
        if through is None or not isinstance(through.iter, ast.Name) or through.iter.id not in listed:
            continue
        for child in ast.walk(node):
            is_place = isinstance(child, ast.Subscript) and names(child.slice) & names(through.target)
            if isinstance(child, ast.Subscript) and is_place and names(child.value) & (answered - again):
                yield child
