"""A scripted environment and a scripted policy, as an evaluation loop meets them: what it does to them is recorded.

No observation and no action has content. Each is a token that says whose it is and when it was made, so that it can be
told which observation was shown, which action was executed, and whether the loop changed it in between.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final

from xpl import _spec as sdk
from xpl_cli.audit.static.adapter import ACT, ACT_BATCH, RESET, UPDATE, UPDATE_BATCH
from xpl_cli.standard import spec

OPERATIONS: Final = frozenset(spec.data("package")["task_env"]["operations"])
"""What a loop may ask of an environment."""
_AFTER: Final = 3
"""Chunks after the end of all episodes, after which a loop is taken to go on for ever."""


class Kind(StrEnum):
    """What a loop did."""

    RESET = "resets the policy"
    SHOWN = "shows an observation"
    ASKED = "asks for actions"
    MOVED = "executes actions"
    ENVIRONMENT = "does something else to the environment"
    RAISED = "stops with an error"
    ENDED = "ends"


@dataclass(frozen=True)
class Event:
    """One thing that a loop did.

    Attributes:
        what: to what: tokens as `Token.told` tells them, environments, or a name.
        place: where the loop did it: file and node.
    """

    kind: Kind
    what: tuple[Any, ...] = ()
    place: tuple[str, ast.AST] | None = field(default=None, compare=False, repr=False)


@dataclass(eq=False)
class Opaque:
    """A value of which nothing is known but what it is a part of."""

    root: Token | None = None


@dataclass(eq=False)
class Token(Opaque):
    """An observation or an action.

    Attributes:
        env: the environment it is of.
        time: how many actions the environment had executed when the observation was taken; which answer it is from.
        place: of an action, its place in the chunk; -1 for an observation.
        changed: whether the loop made something else of it.
    """

    env: int = 0
    time: int = 0
    place: int = -1
    changed: bool = False

    def __post_init__(self) -> None:
        """A token is part of itself."""
        self.root = self

    def copy(self, *, changed: bool = False) -> Token:
        """Return another one that can be changed apart."""
        return Token(env=self.env, time=self.time, place=self.place, changed=self.changed or changed)

    def told(self) -> tuple[int, int, int, bool]:
        """Return what it stands for."""
        return self.env, self.time, self.place, self.changed


class PolicyFailed(Exception):  # noqa: N818 - part of the script, not a fault of this program
    """The scripted policy fails, as the scenario wants it."""


@dataclass(frozen=True)
class Scenario:
    """One evaluation.

    Attributes:
        lengths: environments, and after how many actions each of them ends.
        horizon: actions in a chunk.
        fails_at: which inference fails, from 1; 0 for none.
        keeps_list: whether the list of running environments stays whole, so that `is_episode_end` alone tells the end.
    """

    lengths: tuple[tuple[int, int], ...]
    horizon: int
    fails_at: int = 0
    keeps_list: bool = False


class NeverEnds(Exception):  # noqa: N818 - an answer, not a fault of this program
    """The loop goes on, chunk after chunk, when all episodes have ended; the argument is where it moves."""


class World:
    """The environment and the policy of a scenario. Methods with the names of the standard are the environment's.

    Attributes:
        events: what the loop did so far.
        place: where the loop is, file and node; set by whoever follows it.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.events: list[Event] = []
        self.place: tuple[str, ast.AST] | None = None
        self._scenario = scenario
        self._lengths = dict(scenario.lengths)
        self._moved = dict.fromkeys(self._lengths, 0)
        self._shown: list[int] = []
        self._answers = 0

    def note(self, kind: Kind, *what: Any) -> None:
        """Record what the loop does; in which order it names environments changes nothing."""
        self.events.append(Event(kind, tuple(sorted(what, key=str)), self.place))

    def get_obs(self, *_: Any) -> Token:
        """Return the first environment's observation."""
        return self._observe(next(iter(self._lengths)))

    def get_obs_batch(self, env_idx_list: Any = None, last_frame: Any = False) -> list[Token]:  # noqa: ARG002, FBT002
        """Return the observations of some environments, None for those that are running."""
        chosen = self.get_running_env_idx_list() if env_idx_list is None else env_idx_list
        return [self._observe(env) for env in chosen]

    def take_action(self, action: Any) -> Opaque:
        """Move the first environment."""
        return self.take_action_batch([action], [next(iter(self._lengths))])

    def take_action_batch(self, actions: Any, env_idx_list: Any) -> Opaque:
        """Move some environments.

        Raises:
            NeverEnds: all episodes ended chunks ago.
        """
        late = _AFTER * self._scenario.horizon
        if self._scenario.keeps_list and all(moved >= self._lengths[env] + late for env, moved in self._moved.items()):
            raise NeverEnds(self.place)
        envs = [env for env in env_idx_list if env in self._moved]
        self.note(Kind.MOVED, *zip(envs, map(_told, actions), strict=False))
        for env in envs:
            self._moved[env] += 1
        return Opaque()

    def is_episode_end(self) -> bool:
        """Tell whether all episodes have ended."""
        return not self._running()

    def get_running_env_idx_list(self) -> list[int]:
        """Return the environments whose episode goes on, or all of them where the scenario wants it."""
        return list(self._lengths) if self._scenario.keeps_list else self._running()

    def _running(self) -> list[int]:
        return [env for env, length in self._lengths.items() if self._moved[env] < length]

    def results(self) -> Opaque:
        """Return what nobody asks about here."""
        return Opaque()

    def reset(self, *_: Any, **__: Any) -> Opaque:
        """Record that the loop resets the environment."""
        self.note(Kind.ENVIRONMENT, RESET)
        return Opaque()

    def close(self) -> Opaque:
        """Record that the loop closes the environment."""
        self.note(Kind.ENVIRONMENT, sdk.Message.CLOSE)
        return Opaque()

    def asked(self, operation: str, given: Any) -> Any:
        """Return what the policy answers.

        Raises:
            PolicyFailed: if the scenario says so.
        """
        if operation in {UPDATE, UPDATE_BATCH}:
            tokens = given if isinstance(given, list) else [given]
            self._shown = [token.env for token in tokens if isinstance(token, Token)]
            self.note(Kind.SHOWN, *map(_told, tokens))
        elif operation in {ACT, ACT_BATCH}:
            return self._answer(operation, given)
        elif operation == RESET:
            self.note(Kind.RESET)
        return Opaque()

    def _answer(self, operation: str, given: Any) -> Any:
        envs = self._shown if operation == ACT or given is None else list(given)
        self.note(Kind.ASKED, *envs)
        self._answers += 1
        if self._answers == self._scenario.fails_at:
            raise PolicyFailed
        chunks = [[Token(None, env, self._answers, step) for step in range(self._scenario.horizon)] for env in envs]
        return chunks if operation == ACT_BATCH else (chunks or [[]])[0]

    def _observe(self, env: int) -> Token:
        return Token(None, env, self._moved.get(env, 0))


def _told(value: Any) -> Any:
    if isinstance(value, Token):
        return value.told()
    if isinstance(value, Opaque) and value.root is not None:
        return value.root.copy(changed=True).told()
    return None


def changed(value: Any) -> Any:
    """Return what an unknown function may make of a value: its tokens are marked."""
    if isinstance(value, Token):
        return value.copy(changed=True)
    if isinstance(value, (list, tuple)) and _tokens(value):
        return [changed(entry) for entry in value]
    return Opaque(value.root if isinstance(value, Opaque) else None)


def _tokens(values: Iterable[Any]) -> bool:
    return any(isinstance(value, Token) or (isinstance(value, (list, tuple)) and _tokens(value)) for value in values)
