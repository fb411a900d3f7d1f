"""Parallel map over processes; the results come in the order of the items."""

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
"""Items per process that are submitted ahead."""


def map_in_processes(
    work: Callable[[Item], Result], items: Sequence[Item], workers: int | None = None
) -> Iterator[Result | None]:
    """Yield `work(item)` for each item, in order; None where its process died.

    Processes are forked, so that imports are shared; `workers` is their number, by default that of the cores. An
    exception of `work` is raised here. Items are submitted as results are taken.
    """
    if not items:
        return
    count = min(workers or cores(), len(items))
    rest = iter(items)
    waiting: collections.deque[Future[Result]] = collections.deque()
    with warnings.catch_warnings(), _pool(count) as pool:
        # Threads of this process, if any, only print; forked processes do not use them.
        warnings.filterwarnings("ignore", message=".*multi-threaded", category=DeprecationWarning)
        try:
            for index in range(len(items)):
                try:
                    waiting += [
                        pool.submit(work, item) for item in itertools.islice(rest, _AHEAD * count - len(waiting))
                    ]
                    answer = waiting.popleft().result()
                except BrokenProcessPool:
                    # One dead process breaks the pool: each remaining item gets a process of its own.
                    yield from (_run_alone(work, item) for item in items[index:])
                    return
                yield answer
        except BaseException as error:
            # An interrupt does not wait; otherwise the pool's thread has to end first.
            pool.shutdown(wait=isinstance(error, Exception), cancel_futures=True)
            raise


@functools.lru_cache(maxsize=1)
def end_with_parent(parent: int) -> None:
    """Have the system kill this process when its parent ends, however that ends."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _run_alone(work: Callable[[Item], Result], item: Item) -> Result | None:
    with _pool(1) as pool:
        try:
            return pool.submit(work, item).result()
        except BrokenProcessPool:
            return None


def _pool(size: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(size, multiprocessing.get_context("fork"), initializer=_leave_signals_to_the_parent)


def _leave_signals_to_the_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
