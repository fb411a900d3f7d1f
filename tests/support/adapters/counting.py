"""The policy of the fault suite: it does nothing but keep count, so that a lost, repeated or swapped step shows.

Served as `model.py` of an adapter (standard library and numpy, Python 3.9), and imported by the tests, which keep the
same count on the client's side.
"""

from __future__ import annotations

import zlib
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

HELD = 4
"""Observations that an episode's ledger keeps, as an adapter with a history does."""


class Ledger:
    """What was done in one episode of one environment, in order.

    Attributes:
        steps: how many observations and questions there were.
        checksum: CRC-32 over all of them and their order, images included.
        last: number of the newest observation, -1 before the first.
    """

    def __init__(self) -> None:
        self.steps, self.checksum, self.last = 0, 0, -1
        self._held: deque[tuple[int, Any]] = deque(maxlen=HELD)

    def observe(self, obs: Mapping[str, Any]) -> None:
        """Enter an observation."""
        self.last = int(obs["n"])
        content = checksum(obs)
        self._held.append((content, obs))
        self._enter(f"observe {self.last} {content}")

    def ask(self) -> None:
        """Enter a question for actions."""
        self._enter("ask")

    def summary(self) -> list[int]:
        """Return steps, checksum, last, and how many of the held observations have changed since they were entered."""
        spoiled = sum(content != checksum(obs) for content, obs in self._held)
        return [self.steps, self.checksum, self.last, spoiled]

    def _enter(self, line: str) -> None:
        self.steps += 1
        self.checksum = zlib.crc32(line.encode(), self.checksum)


def checksum(obs: Mapping[str, Any]) -> int:
    """Return the CRC-32 of all arrays in an observation, with their keys."""
    total = 0
    for path, array in _arrays(obs, ""):
        total = zlib.crc32(path.encode(), total)
        total = zlib.crc32(np.ascontiguousarray(array).tobytes(), total)
    return total


def _arrays(value: Any, path: str) -> Iterator[tuple[str, np.ndarray]]:
    if isinstance(value, np.ndarray):
        yield path, value
    elif isinstance(value, Mapping):
        for key in sorted(value):
            yield from _arrays(value[key], f"{path}/{key}")


class Model:
    """Keeps a ledger for each environment; actions are its summary.

    Attributes:
        ledgers: by environment.
        newest: environments of the newest observations.
    """

    def __init__(self, config: Mapping[str, Any]) -> None:
        self.reset()

    def reset_envs(self, env_idx_list: Sequence[int]) -> None:
        """Begin an episode in some environments, where several clients share the model."""
        for env in env_idx_list:
            self.ledgers.pop(env, None)

    def reset(self) -> None:
        """Begin an episode."""
        self.ledgers: dict[int, Ledger] = {}
        self.newest: list[int] = []
        self._fifo: str | None = None

    def update_obs(self, obs: Mapping[str, Any]) -> None:
        """Enter one observation."""
        self.update_obs_batch([obs])

    def update_obs_batch(self, obs_list: Sequence[Mapping[str, Any]]) -> None:
        """Enter one observation for each environment."""
        self.newest = [int(obs["env_idx"]) for obs in obs_list]
        for obs in obs_list:
            self.ledgers.setdefault(int(obs["env_idx"]), Ledger()).observe(obs)
            self._fifo = obs.get("fifo")

    def get_action(self) -> list[dict[str, Any]]:
        """Return the summary of the newest environment."""
        return self.get_action_batch(self.newest[-1:])[0]

    def get_action_batch(self, env_idx_list: Sequence[int] | None = None) -> list[list[dict[str, Any]]]:
        """Return the summaries of some environments; thinks as long as the newest observation's named pipe is empty."""
        if self._fifo is not None:
            with open(self._fifo) as pipe:  # noqa: PTH123 - as an adapter would
                pipe.read()
        wanted = self.newest if env_idx_list is None else env_idx_list
        for env in wanted:
            self.ledgers[env].ask()
        return [[{"summary": self.ledgers[env].summary()}] for env in wanted]

    def infer(self, obs: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Enter an observation and return the summary, as one unit."""
        self.update_obs(obs)
        return self.get_action()

    def large(self, size: int) -> np.ndarray:
        """Return an array of `size` bytes."""
        return np.full(size, size % 251, np.uint8)
