"""Detect whether silent processes work or hang, by their activity.

Input and output, changing memory, and starting and ending processes are progress. Processor time alone is activity, but
an endless loop uses it too; so a process that only computes may take four times as long and no more.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.isolation import processes

if TYPE_CHECKING:
    from collections.abc import Iterable

LONGER = 4
"""How many times longer a process may compute without progress than be inactive."""
HUNG = ("gave no sign of life", "made no headway", "did not answer within", "could not be loaded within")
"""Phrases in the reasons for a hanging adapter."""
_CHECKS = 8
"""Least checks per patience; at least one per second."""
_IDLE = 0.01
"""Share of a processor below which a process counts as idle: polling threads take less."""
_BYTES, _MEMORY = 4096, 1 << 20
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class ActivitySnapshot:
    """Activity of processes so far: processor time in s, bytes read and written, memory in bytes, their pids."""

    processor: float
    moved: int
    memory: int
    members: frozenset[int]
    stopped: bool

    @classmethod
    def of(cls, pids: Iterable[int]) -> ActivitySnapshot:
        """Measure processes."""
        members = frozenset(pids)
        activities = [processes.activity(pid) for pid in members]
        ticks = sum(one.ticks for one in activities)
        moved = sum(one.moved for one in activities)
        memory = sum(processes.resident_bytes(pid) for pid in members)
        return cls(ticks / _TICKS, moved, memory, members, any(one.stopped for one in activities))


class HangDetector:
    """Watches a process and its descendants during one request.

    Args:
        pid: the process.
        patience: longest time without activity, s.
        now: the time, s of `time.monotonic`.
    """

    def __init__(self, pid: int, patience: float, now: float) -> None:
        self._pid = pid
        self._patience = patience
        self._snapshot = ActivitySnapshot.of(processes.tree_pids(pid))
        self._checked_at = self._active_at = self._progress_at = now
        self.every_s = min(1.0, patience / _CHECKS)

    def check(self, now: float) -> str | None:
        """Measure again; return why the process counts as hanging, or None."""
        current, previous = ActivitySnapshot.of(processes.tree_pids(self._pid)), self._snapshot
        if (
            abs(current.moved - previous.moved) > _BYTES
            or abs(current.memory - previous.memory) > _MEMORY
            or current.members != previous.members
        ):
            self._progress_at, self._snapshot = now, current
        if current.processor - previous.processor > _IDLE * (now - self._checked_at) or self._progress_at == now:
            self._active_at = now
        self._snapshot = ActivitySnapshot(
            current.processor, self._snapshot.moved, self._snapshot.memory, current.members, current.stopped
        )
        self._checked_at = now
        if now - self._active_at >= self._patience:
            how = "it is stopped by a signal" if current.stopped else "no processor time, input or output"
            return f"{HUNG[0]} for {self._patience:g} s ({how}; --patience)"
        if now - self._progress_at >= LONGER * self._patience:
            return f"{HUNG[1]} for {LONGER * self._patience:g} s: it computes, and reads, writes and stores nothing"
        return None
