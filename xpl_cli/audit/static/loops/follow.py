"""Follows an evaluation function on its syntax tree, statement by statement, against a scripted environment and policy.

It is a reader with pencil and paper, not an interpreter of Python: nothing of the adapter is imported or executed, and
there is nothing here that could read a file or open a connection. What it does not know is opaque; where that would
reach the environment or the client, it gives up (`Unclear`) instead of guessing.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.audit.static.loops.reader import CLIENT, ENVIRONMENT, Defined, Reader, Resolve
from xpl_cli.audit.static.loops.values import Choices, Raised, Unclear, binary, entries
from xpl_cli.audit.static.loops.world import Event, Kind, Opaque, PolicyFailed, Scenario, Token, World

if TYPE_CHECKING:
    from xpl_cli.audit.static.function import Function

_UNSEEN: Final = 2
"""Rounds of a loop whose condition nobody knows."""
_BREAK, _CONTINUE = object(), object()


def follow(function: Function, resolve: Resolve, scenario: Scenario, choices: Choices) -> tuple[Event, ...]:
    """Return what an evaluation function does in a scenario.

    Raises:
        Unclear: if it cannot be followed.
    """
    world = World(scenario)
    reader = _Follower(world, resolve, choices)
    try:
        reader.call(Defined(function.file, function.node), [ENVIRONMENT, CLIENT], {})
    except (Raised, PolicyFailed):
        world.note(Kind.RAISED)
    except RecursionError:
        raise Unclear("its functions call each other without end") from None
    else:
        world.place = (function.file, function.node)
        world.note(Kind.ENDED)
    return tuple(world.events)


@dataclass(frozen=True)
class _Returned:
    """A function has ended."""

    value: Any


class _Follower(Reader):
    def __init__(self, world: World, resolve: Resolve, choices: Choices) -> None:
        super().__init__(world, resolve, choices)
        self._statements: Mapping[type[ast.stmt], Callable[[Any], Any]] = {
            ast.Expr: self._evaluated,
            ast.Assign: self._assign,
            ast.AnnAssign: self._annotated,
            ast.AugAssign: self._augmented,
            ast.If: lambda node: self._block(node.body if self.holds(node.test) else node.orelse),
            ast.For: self._for,
            ast.While: self._while,
            ast.Break: lambda _: _BREAK,
            ast.Continue: lambda _: _CONTINUE,
            ast.Return: lambda node: _Returned(None if node.value is None else self.value(node.value)),
            ast.Raise: self._raise,
            ast.Try: self._try,
            ast.With: self._with,
            ast.FunctionDef: self._define,
            ast.Import: self._import,
            ast.ImportFrom: self._import,
        }

    def body(self, body: Sequence[ast.stmt]) -> Any:
        """Follow the body of a function and return what it returns."""
        ended = self._block(body)
        return ended.value if isinstance(ended, _Returned) else None

    def _block(self, body: Sequence[ast.stmt]) -> Any:
        for statement in body:
            self.count()
            handler = self._statements.get(type(statement))
            if handler is not None:
                if (ended := handler(statement)) is not None:
                    return ended
            elif not isinstance(statement, (ast.Pass, ast.Assert, ast.Global, ast.Nonlocal, ast.Delete, ast.ClassDef)):
                raise Unclear(f"line {statement.lineno} is a statement of a kind that loops do not need")
        return None

    def _assign(self, node: ast.Assign) -> None:
        value = self.value(node.value)
        for target in node.targets:
            self.store(target, value)

    def _annotated(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.store(node.target, self.value(node.value))

    def _evaluated(self, node: ast.Expr) -> None:
        self.value(node.value)

    def _augmented(self, node: ast.AugAssign) -> None:
        self.store(node.target, binary(node.op, self.value(node.target), self.value(node.value)))

    def _for(self, node: ast.For) -> Any:
        through = self.value(node.iter)
        values = entries(through)
        if values is None:
            root = through.root if isinstance(through, Opaque) else None
            values = [Opaque(root)] if self.choices.of(node) else []
        for value in values:
            self.store(node.target, value)
            ended = self._block(node.body)
            if ended is _BREAK:
                return None
            if isinstance(ended, _Returned):
                return ended
        return self._block(node.orelse)

    def _while(self, node: ast.While) -> Any:
        unseen = 0
        while True:
            self.count()
            value = self.value(node.test)
            if isinstance(value, Opaque) and not isinstance(value, Token):
                unseen += 1
                if unseen > _UNSEEN or not self.choices.of(node):
                    break
            elif not value:
                break
            ended = self._block(node.body)
            if ended is _BREAK:
                return None
            if isinstance(ended, _Returned):
                return ended
        return self._block(node.orelse)

    def _raise(self, node: ast.Raise) -> Any:
        self.world.place = (self.file, node)
        raise Raised

    def _try(self, node: ast.Try) -> Any:
        try:
            try:
                ended = self._block(node.body)
                ended = self._block(node.orelse) if ended is None else ended
            except (Raised, PolicyFailed):
                if not node.handlers:
                    raise
                ended = self._block(node.handlers[0].body)
        finally:
            last_word = self._block(node.finalbody)
        return ended if last_word is None else last_word

    def _with(self, node: ast.With) -> Any:
        for entry in node.items:
            value = self.value(entry.context_expr)
            if entry.optional_vars is not None:
                self.store(entry.optional_vars, value)
        return self._block(node.body)

    def _define(self, node: ast.FunctionDef) -> None:
        self.scope[node.name] = Defined(self.file, node, self.scope)

    def _import(self, node: ast.Import | ast.ImportFrom) -> None:
        for alias in node.names:
            name = alias.asname or alias.name.partition(".")[0]
            found = self.resolve(self.file, name)
            self.scope[name] = Opaque() if found is None or isinstance(found, ast.expr) else found
