"""Work on many things in several processes; the answers come in the order of the things."""

from __future__ import annotations

import collections
import ctypes
import functools
import itertools
import multiprocessing
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
_AHEAD = 8
"""Things for each process that are handed out before their answers are taken."""


def map_in_processes(
    work: Callable[[Item], Result], items: Sequence[Item], workers: int | None = None
) -> Iterator[Result | None]:
    """Yield `work(thing)` for each thing, in order; None where the process that worked on it died.

    Processes are forked, so that what is imported already need not be imported again; `workers` is their number, that
    of the cores by default. An exception of `work` is raised here. Things are handed out as answers are taken, so that
    those that wait are few.
    """
    if not items:
        return
    count = min(workers or _cores(), len(items))
    rest = iter(items)
    waiting: collections.deque[Future[Result]] = collections.deque()
    with warnings.catch_warnings(), _pool(count) as pool:
        # Threads of this process, if any, only print; what is forked uses nothing of theirs.
        warnings.filterwarnings("ignore", message=".*multi-threaded", category=DeprecationWarning)
        try:
            for index in range(len(items)):
                try:
                    waiting += [
                        pool.submit(work, thing) for thing in itertools.islice(rest, _AHEAD * count - len(waiting))
                    ]
                    answer = waiting.popleft().result()
                except BrokenProcessPool:
                    # One death takes the whole pool: whoever has no answer gets a process of its own.
                    yield from (_run_alone(work, thing) for thing in items[index:])
                    return
                yield answer
        except BaseException as error:
            # Nobody who interrupts waits; else the pool's thread ends first, which Python would meet half closed.
            pool.shutdown(wait=isinstance(error, Exception), cancel_futures=True)
            raise


@functools.lru_cache(maxsize=1)
def end_with_parent(parent: int) -> None:
    """Let the system end this process when its parent has gone, whatever ended that: nobody else would."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)


def _cores() -> int:
    """Return how many cores this process may use, as far as the system tells."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _run_alone(work: Callable[[Item], Result], thing: Item) -> Result | None:
    with _pool(1) as pool:
        try:
            return pool.submit(work, thing).result()
        except BrokenProcessPool:
            return None


def _pool(size: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(size, multiprocessing.get_context("fork"), initializer=_leave_signals_to_the_parent)


def _leave_signals_to_the_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
