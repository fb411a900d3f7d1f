"""Which seeds are played next, and which trials are played again."""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl.vector import INFRASTRUCTURE

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence


class Schedule:
    """The episodes of an evaluation, each with its seed, several at a time.

    A trial that the infrastructure spoilt says nothing about the policy: its seed is played again, and where all
    attempts fail, its last result stands. The others of the same batch count.

    Args:
        seeds: one for each episode, all different.
        places: episodes that are played at a time; places left over at the end play seeds that nobody asked for.
        attempts: how often a seed is played at most.
    """

    def __init__(self, seeds: Sequence[int], places: int, attempts: int) -> None:
        self._seeds = list(seeds)
        self._places = places
        self._attempts = attempts
        self._waiting = deque(self._seeds)
        self._played: Counter[int] = Counter()
        self._results: dict[int, dict[str, Any]] = {}

    @property
    def is_done(self) -> bool:
        """Whether every seed has its result."""
        return len(self._results) == len(self._seeds)

    @property
    def results(self) -> list[dict[str, Any]]:
        """The results so far, in the order of the seeds, with the number of `attempts`."""
        known = (seed for seed in self._seeds if seed in self._results)
        return [{**self._results[seed], "attempts": self._played[seed]} for seed in known]

    def next(self) -> list[int]:
        """Return the seeds of the next trial, one for each place."""
        count = min(self._places, len(self._waiting))
        chosen = [self._waiting.popleft() for _ in range(count)]
        beyond = max(self._seeds) + 1
        return [*chosen, *range(beyond, beyond + self._places - count)]

    def add(self, results: Iterable[Mapping[str, Any]]) -> None:
        """Take the results of a trial; seeds that are to be played again come first."""
        again = []
        for result in results:
            seed = result[sdk.Deploy.SEED]
            if seed not in self._seeds:
                continue
            self._played[seed] += 1
            if result.get("end_reason") == INFRASTRUCTURE and self._played[seed] < self._attempts:
                again.append(seed)
            else:
                self._results[seed] = dict(result)
        self._waiting.extendleft(reversed(again))


def spoilt(seeds: Iterable[int], error: Exception) -> list[dict[str, Any]]:
    """Return the results of a trial that an error of the infrastructure ended as a whole."""
    outcome = {"success": None, "score": None, "end_reason": INFRASTRUCTURE, "error": str(error)}
    return [{sdk.Obs.ENV_IDX: env, sdk.Deploy.SEED: seed, **outcome} for env, seed in enumerate(seeds)]
