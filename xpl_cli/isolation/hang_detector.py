"""Whether processes that nobody hears from are at work or hang: what they do can be seen from outside.

Signs of headway are input and output, memory that changes, and processes that come and go. Processor time alone is a
sign of life, but a loop without end gives it too; so it buys patience four times as long and no more.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.isolation import processes

if TYPE_CHECKING:
    from collections.abc import Iterable

LONGER = 4
"""How much longer a process may compute without headway than it may be silent."""
HUNG = ("gave no sign of life", "made no headway", "did not answer within", "could not be loaded within")
"""What reasons say of an adapter that hangs."""
_LOOKS = 8
"""Looks in the time of one patience, at least; and one a second."""
_IDLE = 0.01
"""Share of a processor below which a process only waits: threads that look after something take less."""
_BYTES, _MEMORY = 4096, 1 << 20
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class ActivitySnapshot:
    """What processes have done so far: processor time in s, bytes read and written, memory in bytes, their numbers."""

    processor: float
    moved: int
    memory: int
    members: frozenset[int]
    stopped: bool

    @classmethod
    def of(cls, pids: Iterable[int]) -> ActivitySnapshot:
        """Look at processes."""
        members = frozenset(pids)
        activities = [processes.activity(pid) for pid in members]
        ticks = sum(one.ticks for one in activities)
        moved = sum(one.moved for one in activities)
        memory = sum(processes.resident_bytes(pid) for pid in members)
        return cls(ticks / _TICKS, moved, memory, members, any(one.stopped for one in activities))


class HangDetector:
    """Follows a process and those below it through one piece of work.

    Args:
        pid: the process.
        patience: how long it may be silent, s.
        now: the time, s of `time.monotonic`.
    """

    def __init__(self, pid: int, patience: float, now: float) -> None:
        self._pid = pid
        self._patience = patience
        self._seen = ActivitySnapshot.of(processes.tree_pids(pid))
        self._looked = self._alive = self._ahead = now
        self.every_s = min(1.0, patience / _LOOKS)

    def check(self, now: float) -> str | None:
        """Look again; return why the work is to be ended, or None as long as there is hope."""
        seen, before = ActivitySnapshot.of(processes.tree_pids(self._pid)), self._seen
        if (
            abs(seen.moved - before.moved) > _BYTES
            or abs(seen.memory - before.memory) > _MEMORY
            or seen.members != before.members
        ):
            self._ahead, self._seen = now, seen
        if seen.processor - before.processor > _IDLE * (now - self._looked) or self._ahead == now:
            self._alive = now
        self._seen = ActivitySnapshot(seen.processor, self._seen.moved, self._seen.memory, seen.members, seen.stopped)
        self._looked = now
        if now - self._alive >= self._patience:
            how = "it is stopped by a signal" if seen.stopped else "no processor time, input or output"
            return f"{HUNG[0]} for {self._patience:g} s ({how}; --patience)"
        if now - self._ahead >= LONGER * self._patience:
            return f"{HUNG[1]} for {LONGER * self._patience:g} s: it computes, and reads, writes and stores nothing"
        return None
