"""The single change around an adapter that explains its differences, looked for with few plays of its episodes.

What is shown to an adapter costs a play. Each change is tried on the shortest episodes that differ; only what helps
there is tried on all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING

from xpl_cli.native.difference import Answers, Given, Thread, differences
from xpl_cli.native.explain import Explanation, Tried, explain
from xpl_cli.native.fitted import fitted

if TYPE_CHECKING:
    from xpl_cli.native.alternatives.signals import Signal
    from xpl_cli.native.alternatives.signals.signal import Shown
    from xpl_cli.native.difference import Differences

_FEW = 3
"""Questions that a change is tried on first, at least."""
_HELPS = 0.34
"""A change is tried on all if no more than this share of the difference remains on the few, ..."""
_MENDS = 0.05
"""... or no more than this of that of one number."""


Play = Callable[["Shown", bool, Sequence[int]], "Sequence[Answers] | None"]
"""Plays some threads, by their numbers, with other observations, each question alone if so told, and returns their
answers; None where the adapter or a limit of time refuses."""


def search(
    threads: Sequence[Thread],
    signals: Iterable[Signal],
    play: Play,
    spread: Differences,
    tolerance: float,
) -> Explanation:
    """Return which signal explains best that answers differ from the native ones.

    Args:
        threads: all episodes that were played.
        signals: the changes, the likeliest first.
        play: plays episodes.
        spread: of `difference.spreads` of all native answers.
        tolerance: largest share of it that is no difference.
    """
    tried = _Trial(threads, play, spread)
    before = tried.left([thread.given for thread in threads], range(len(threads)))
    if max(before.values(), default=0.0) <= tolerance:
        return explain(before, (), tolerance)
    few = _shortest(threads, spread, tolerance)
    first = tried.left([threads[number].given for number in few], few)
    helped: list[tuple[float, Signal]] = []
    for signal in signals:
        left = tried.signal(signal, few)
        if left is not None and _helps(first, left, tolerance):
            helped.append((max(left.values()), signal))
    helped.sort(key=lambda one: one[0])
    everything = range(len(threads))
    # Those that leave nothing on the few are many where changes are the same by effect; others are few and told apart.
    chosen = [signal for _, signal in helped[:_MOST]]
    found = [
        Tried(signal.words, signal.convention, left)
        for signal in sorted(chosen, key=lambda one: one.rank)
        if (left := tried.signal(signal, everything)) is not None
    ]
    line = fitted(threads, before, spread, tolerance)
    best = explain(before, found, tolerance)
    if best.cause is None and line is not None:
        return explain(before, [*found, line], tolerance)
    return best


_MOST = 24
"""Changes that are tried on all episodes."""


class _Trial:
    """Plays what is shown once for all changes that share it."""

    def __init__(self, threads: Sequence[Thread], play: Play, spread: Differences) -> None:
        self._threads, self._play, self._spread = threads, play, spread
        self._played: dict[tuple[Shown, bool, tuple[int, ...]], Sequence[Answers] | None] = {}

    def signal(self, signal: Signal, chosen: Sequence[int]) -> Differences | None:
        """Return what remains with a change on some threads, or None where it cannot be tried."""
        answers: Sequence[Answers] | None = [self._threads[number].given for number in chosen]
        if signal.shown is not None:
            key = (signal.shown, signal.windowed, tuple(chosen))
            if key not in self._played:
                self._played[key] = self._play(signal.shown, signal.windowed, tuple(chosen))
            answers = self._played[key]
        if answers is None:
            return None
        changed: list[Given] = list(answers)
        if signal.commanded is not None:
            try:
                changed = [
                    signal.commanded(given, self._threads[number].observations, self._threads[number].asked)
                    for given, number in zip(answers, chosen, strict=True)
                ]
            except (ValueError, KeyError):  # a rotation of length zero, a field that the robot lacks
                return None
        return self.left(changed, chosen)

    def left(self, answers: Sequence[Given], chosen: Sequence[int]) -> Differences:
        """Return how far answers to the questions of some threads are from the native ones."""
        native = [chunk for number in chosen for chunk in self._threads[number].native]
        return differences(native, [chunk for given in answers for chunk in given], self._spread)


def _shortest(threads: Sequence[Thread], spread: Differences, tolerance: float) -> list[int]:
    """Return the numbers of the shortest threads that show every difference, with a few questions."""
    off = [_off(thread, spread, tolerance) for thread in threads]
    wanted, chosen, questions = set().union(*off), list[int](), 0
    for number in sorted(range(len(threads)), key=lambda one: len(threads[one].observations)):
        if wanted or questions < _FEW:
            chosen.append(number)
            wanted -= off[number]
            questions += len(threads[number].asked)
    return chosen


def _off(thread: Thread, spread: Differences, tolerance: float) -> set[str]:
    left = differences(thread.native, thread.given, spread)
    return {part for part, value in left.items() if value > tolerance}


def _helps(before: Differences, left: Differences, tolerance: float) -> bool:
    if max(left.values()) <= max(_HELPS * max(before.values()), tolerance):
        return True
    off = [part for part, value in before.items() if value > tolerance]
    return any(left[part] <= max(_MENDS * before[part], tolerance) for part in off) and all(
        left[part] <= max(1.05 * before[part], tolerance) for part in before
    )
