"""What an evaluation function does otherwise than the reference, and what that changes.

Both are followed through the same scripted evaluations (`follow`). What a loop logs, times, names
or keeps books with leaves no trace there; a difference is what the policy is shown or asked, and what the environment
is made to do.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import takewhile
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl_cli.audit.static.adapter import RESET, symbols
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.loops.distance import unmatched
from xpl_cli.audit.static.loops.follow import follow
from xpl_cli.audit.static.loops.functions import wanted
from xpl_cli.audit.static.loops.nodes import nodes, nodes_of
from xpl_cli.audit.static.loops.values import Choices, Unclear
from xpl_cli.audit.static.loops.world import Event, Kind, NeverEnds, Scenario
from xpl_cli.basics.content import room
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from xpl_cli.audit.static.source import Source

_ATTEMPTS: Final = 24
"""Combinations of what opaque conditions may be that are tried."""
_FAILURES: Final = 4
"""Combinations that cannot be followed until the function counts as unclear."""
_SINGLE: Final = (Scenario(((0, 10),), 4), Scenario(((0, 4),), 2), Scenario(((0, 8),), 4, fails_at=2))
_BATCH: Final = (
    Scenario(((2, 10), (5, 3), (9, 6)), 4),
    Scenario(((2, 4), (9, 4)), 2),
    Scenario(((2, 8), (9, 8)), 4, fails_at=2),
)
_KEPT_SINGLE: Final = Scenario(((0, 6),), 4, keeps_list=True)
_KEPT_BATCH: Final = Scenario(((0, 6), (1, 6)), 4, keeps_list=True)
_COUNTED: Final = range(11, 501)
"""Numbers in a loop that may be a limit of steps: an episode that is longer shows it."""
_HORIZON: Final = 8


@dataclass(frozen=True)
class Difference:
    """The first thing that a loop does otherwise.

    Attributes:
        consequence: what it changes, as the rest of a sentence about the function.
        expected, got: what the reference does there, and what this loop does.
        place: where, file and node; None if the loop does nothing at all.
    """

    consequence: str
    expected: str
    got: str
    place: tuple[str, ast.AST] | None


def differences(function: Function, source: Source) -> Iterator[Difference]:
    """Yield the differences of an evaluation function from the reference, one for each evaluation that shows another.

    Raises:
        Unclear: if the function cannot be followed.
    """
    told: set[tuple[Kind, Kind]] = set()
    for scenario in _scenarios(function, source):
        expected = _expected(function.name, scenario)
        found = _nearest(function, source, scenario, expected)
        place = _agreement(found, expected)
        if place is not None:
            kinds, difference = _judged(expected, found, place)
            if kinds not in told:
                told.add(kinds)
                yield difference


def goes_on_from(function: Function, source: Source) -> tuple[str, ast.AST] | None:
    """Return where an evaluation function moves environments for ever whose end `is_episode_end` alone tells.

    The list of running environments stays whole there, as in the ecosystem's debug client. None: the function ends.

    Raises:
        Unclear: if the function cannot be followed.
    """
    scenario = _KEPT_BATCH if function.name == wanted()[1] else _KEPT_SINGLE
    place: tuple[str, ast.AST] | None = None
    failures: list[Unclear] = []
    choices: Choices | None = Choices()
    for _ in range(_ATTEMPTS):
        if choices is None or len(failures) == _FAILURES:
            break
        try:
            follow(function, _resolver(source), scenario, choices)
        except Unclear as why:
            failures.append(why)
        except NeverEnds as never:
            place = place or never.args[0]
        else:
            return None
        choices = choices.next()
    if place is None:
        raise failures[-1]
    return place


def parted(function: Function, source: Source) -> dict[str, int]:
    """Return how many nodes the normalised tree of a function has, and how many are not the reference's."""
    reference, written = nodes(_references()[function.name].node), nodes_of(function, source)
    return {"nodes": len(reference) + len(written), "without_counterpart": unmatched(reference, written)}


def _scenarios(function: Function, source: Source) -> Iterator[Scenario]:
    is_batch = function.name == wanted()[1]
    yield from _BATCH if is_batch else _SINGLE
    constants = [node.value for node in source.nodes(function.file) if isinstance(node, ast.Constant)]
    numbers = [value for value in constants if isinstance(value, int) and value in _COUNTED]
    if numbers:
        steps = max(numbers) + 2 * _HORIZON + 2
        yield Scenario(((2, steps), (9, steps)) if is_batch else ((0, steps),), _HORIZON)


def _nearest(function: Function, source: Source, scenario: Scenario, expected: Sequence[Event]) -> Sequence[Event]:
    """Return what a loop does, with the opaque conditions that bring it nearest to the reference."""
    nearest: Sequence[Event] | None = None
    longest = -1
    failures: list[Unclear] = []
    choices: Choices | None = Choices()
    for _ in range(_ATTEMPTS):
        if choices is None or len(failures) == _FAILURES:
            break
        try:
            found = follow(function, _resolver(source), scenario, choices)
        except Unclear as why:
            failures.append(why)
        else:
            agreed = _agreement(found, expected)
            if agreed is None:
                return found
            if agreed > longest:
                nearest, longest = found, agreed
        choices = choices.next()
    if nearest is None:
        raise failures[-1]
    return nearest


def _agreement(found: Sequence[Event], expected: Sequence[Event]) -> int | None:
    """Return how many events agree from the beginning, None if all do."""
    if found == expected:
        return None
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(found, expected, strict=False)))


def _resolver(source: Source) -> Any:
    constants: dict[str, Mapping[str, ast.expr]] = {}

    def resolve(file: str, name: str) -> Function | ast.expr | None:
        functions = symbols(source, file).functions
        if name in functions:
            return functions[name]
        if file not in constants:
            constants[file] = _constants(source.tree(file).body)
        return constants[file].get(name)

    return resolve


def _constants(body: Sequence[ast.stmt]) -> dict[str, ast.expr]:
    return {
        target.id: node.value
        for node in body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name) and not any(isinstance(one, ast.Name) for one in ast.walk(node.value))
    }


@cache
def _expected(name: str, scenario: Scenario) -> tuple[Event, ...]:
    """Return what the reference does."""
    return tuple(follow(_references()[name], lambda *_: None, scenario, Choices()))


@cache
def _references() -> Mapping[str, Function]:
    file = spec.newest_path(room("templates") / "loop", spec.CURRENT, sdk.File.DEPLOY_PY)
    body = ast.parse(file.read_text(encoding="utf-8")).body
    return {node.name: Function(file.name, node) for node in body if isinstance(node, ast.FunctionDef)}


def _judged(expected: Sequence[Event], found: Sequence[Event], place: int) -> tuple[tuple[Kind, Kind], Difference]:
    """Return what should be done at the first difference, what is, and what that changes."""
    end = Event(Kind.ENDED)
    should, does = (events[place] if place < len(events) else end for events in (expected, found))
    shown = next((event for event in reversed(found[:place]) if event.kind is Kind.SHOWN), end)
    consequence = _consequence(should, does, shown)
    return (should.kind, does.kind), Difference(consequence, _told(should), _told(does), does.place or shown.place)


def _consequence(should: Event, does: Event, shown: Event) -> str:
    if does.kind is Kind.ENVIRONMENT:
        name = does.what[0]
        return _UNASKED.get(name) or f"uses {name} of the environment, which the standard lacks: other benchmarks stop"
    if does.kind is Kind.SHOWN and does.what == shown.what:
        return "shows the policy the same observation twice: its history counts a step that was none"
    if should.kind is does.kind and should.kind in _SAME:
        return _SAME[should.kind](should, does)
    kinds = (should.kind, does.kind)
    return next(text for (wants, did), text in _CONSEQUENCES if wants in {kinds[0], None} and did in {kinds[1], None})


def _showing(should: Event, does: Event) -> str:
    if [told and told[:3] for told in does.what] == [told and told[:3] for told in should.what]:
        return "shows the policy something else than the environment observed: every other client shows the original"
    wanted_envs, envs = ([told and told[0] for told in event.what] for event in (should, does))
    if envs != wanted_envs:
        return f"shows observations of environments {envs} where {wanted_envs} are running"
    return "shows the policy an observation that is not the present one"


def _moving(should: Event, does: Event) -> str:
    wanted_envs, envs = ([env for env, _ in event.what] for event in (should, does))
    if envs != wanted_envs:
        return f"moves environments {envs} where {wanted_envs} are running"
    told = [action for _, action in does.what]
    if any(action is None or action[3] for action in told):
        return "executes something else than the policy answered: every other client executes the original"
    if any(action[0] != env for env, action in does.what):
        return "executes actions of one environment in another"
    return "executes the actions of a chunk in another order, or some of them twice: the robot leaves the planned path"


def _asking(should: Event, does: Event) -> str:
    return f"asks for environments {list(does.what)} of a batch in which {list(should.what)} were shown"


_UNASKED: Final = {
    RESET: "resets the environment, which the benchmark has set up: the episode is not the one of its seed",
    sdk.Message.CLOSE: "closes the environment, which the benchmark still needs for the next episode",
}
_SAME: Final = {Kind.SHOWN: _showing, Kind.MOVED: _moving, Kind.ASKED: _asking}
_CONSEQUENCES: Final[tuple[tuple[tuple[Kind | None, Kind | None], str], ...]] = (
    ((Kind.RAISED, None), "goes on after the policy has failed: a crash is scored as an episode"),
    ((None, Kind.RAISED), "stops with an error where the reference goes on"),
    ((Kind.RESET, None), "does not begin with a reset: the policy remembers the last episode"),
    ((None, Kind.RESET), "resets the policy once more: it forgets what it has been shown"),
    ((Kind.ENDED, None), "goes on when all episodes have ended"),
    ((None, Kind.ENDED), "ends while the episode goes on: a success that comes later is counted as a failure"),
    ((None, Kind.SHOWN), "shows the policy an observation more than the reference: its history runs ahead"),
    (
        (Kind.SHOWN, Kind.ASKED),
        "asks for a chunk without showing what the last action did: it plans from an older place",
    ),
    ((Kind.SHOWN, Kind.MOVED), "executes an action without showing what the one before did: a history misses a step"),
    ((Kind.MOVED, Kind.ASKED), "asks again before the chunk is executed: the rest of it is thrown away"),
    ((None, Kind.MOVED), "executes actions beyond the chunk: the robot moves where nothing was planned"),
    ((None, None), "does something else than the reference"),
)


def _told(event: Event) -> str:
    """Return an event in words."""
    match event.kind:
        case Kind.SHOWN:
            seen = [
                f"environment {told[0]} after {told[1]} actions" if told else "something else" for told in event.what
            ]
            return f"{event.kind}: {', '.join(seen)}"
        case Kind.MOVED:
            moved = [f"{told[2] + 1} of answer {told[1]}" if told else "something else" for _, told in event.what]
            return f"{event.kind}: {', '.join(moved)}"
        case Kind.ASKED:
            return f"{event.kind} of {', '.join(map(str, event.what))}"
        case Kind.ENVIRONMENT:
            return f"uses {event.what[0]} of the environment"
    return str(event.kind)
