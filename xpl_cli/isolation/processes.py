"""Processes of an adapter: list them, measure their memory, and kill those that have left their group.

Read from /proc; on systems without it, no processes are found.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import stat
import sys
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from xpl.process import spawn

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator, Sequence

_PROC = Path("/proc")
_PAGE = os.sysconf("SC_PAGE_SIZE")
_SET_CHILD_SUBREAPER = 36  # prctl(2)
_MOST_STAT = 4096
"""Bytes; an entry of proc_pid_stat(5) never has a fifth of that."""
_ZOMBIE, _STOPPED = "Z", "T"
_ROUNDS, _ROUND_S = 200, 0.005
"""Rounds of killing, and time between them, s: processes may start others meanwhile."""
LAUNCHERS = 2
"""Launcher processes above an isolated command (`launch.py`; bubblewrap has as many)."""


@dataclass(frozen=True)
class ProcessInfo:
    """A process.

    Attributes:
        pid: its process id.
        parent: pid of its parent, or of the process that adopted it.
        group: its process group; each worker leads its own.
        session: its session.
        started: start time in clock ticks; with the pid it identifies a process.
        name: program name, at most 15 characters.
    """

    pid: int
    parent: int
    group: int
    session: int
    started: int
    name: str

    @property
    def command(self) -> str:
        """Its command line, at most 80 characters."""
        with contextlib.suppress(OSError):
            words = (_PROC / str(self.pid) / "cmdline").read_bytes().decode(errors="replace").split("\0")
            return " ".join(word for word in words if word)[:80] or self.name
        return self.name

    @property
    def is_alive(self) -> bool:
        """Whether it is still running."""
        process = _read_process(self.pid)
        return process is not None and process.started == self.started


def descendants(pid: int) -> list[ProcessInfo]:
    """Return the descendants of a process, and the members of the session that it leads."""
    processes = list(_all_processes())
    # Not its group: in a shell pipeline, the group has the user's other commands. A session is inherited, never joined.
    return _below(pid, processes, {one.pid for one in processes if one.session == pid})


def tree_pids(pid: int) -> list[int]:
    """Return the pids of a process and its descendants."""
    return [pid, *(member.pid for member in descendants(pid))]


def launcher_chain(pid: int) -> list[int]:
    """Return the launcher of an isolated command, the first process of its namespace, and the command.

    The list ends with what there is so far: one that has just been started has nothing below it.
    """
    return first_descendants(pid, LAUNCHERS)


def first_descendants(pid: int, levels: int) -> list[int]:
    """Return a process, its first child, the first child of that, and so on."""
    processes, chain = list(_all_processes()), [pid]
    while len(chain) <= levels:
        children = [member for member in processes if member.parent == chain[-1]]
        if not children:
            break
        # Adopted processes started later.
        chain.append(min(children, key=lambda member: (member.started, member.pid)).pid)
    return chain


@dataclass(frozen=True)
class Activity:
    """Activity of one process: processor time in clock ticks, bytes read and written, whether it is stopped."""

    ticks: int = 0
    moved: int = 0
    stopped: bool = False


def activity(pid: int) -> Activity:
    """Return the activity of a process; zeros where it is unknown."""
    fields = _stat_fields(pid)
    if fields is None:
        return Activity()
    moved = 0
    with contextlib.suppress(OSError, ValueError):
        lines = (_PROC / str(pid) / "io").read_text(encoding="ascii").splitlines()
        moved = sum(int(line.split()[1]) for line in lines if line.startswith(("rchar", "wchar")))
    return Activity(int(fields[1][11]) + int(fields[1][12]), moved, fields[1][0] == _STOPPED)


def resident_bytes(pid: int) -> int:
    """Return the resident memory of one process, bytes; 0 where it is unknown."""
    try:
        return int((_PROC / str(pid) / "statm").read_text(encoding="ascii").split()[1]) * _PAGE
    except (OSError, IndexError, ValueError):
        return 0


def private_bytes(pid: int) -> int | None:
    """Return the private memory of a process, bytes; None where it is unknown."""
    try:
        status = (_PROC / str(pid) / "status").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    line = next((line for line in status.splitlines() if line.startswith("RssAnon:")), None)
    return None if line is None else 1024 * int(line.split()[1])


def proportional_bytes(pid: int) -> int:
    """Return the memory of a process and its descendants, bytes; shared pages count once.

    It is the sum of mapped memory and in-memory files; these are often mapped too, so that the larger of both sums
    counts. Takes some milliseconds for a large process.
    """
    pids = tree_pids(pid)
    sizes = [_proportional(one) for one in pids]
    shared = sum(of_files for _, of_files in sizes)
    return sum(mapped for mapped, _ in sizes) - shared + max(shared, memory_file_bytes(pids))


def memory_file_bytes(pids: Iterable[int]) -> int:
    """Return the bytes of in-memory files that processes have open (`memfd_create`, `/dev/shm`)."""
    return sum({place: size for pid in pids for place, size in _memory_files(pid)}.values())


def adopt_orphans() -> None:
    """Become the parent of descendants that lose theirs (subreaper), so that all stay visible."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, ctypes.c_ulong(1), *[ctypes.c_ulong(0)] * 3)


def kill_tree(leader: int) -> None:
    """Kill the leader of a group, the group and its descendants."""
    for number in tree_pids(leader):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.kill(number, signal.SIGKILL)
    spawn.end_group(leader)  # all that is possible without /proc


def kill_descendants(before: Container[int]) -> list[ProcessInfo]:
    """Kill the descendants of this process until there are none, and return them.

    Args:
        before: pids of descendants at the start, such as a reader of the output that the shell started; they and
            their descendants are spared.
    """
    killed: dict[ProcessInfo, None] = {}
    for _ in range(_ROUNDS):
        left = _below(os.getpid(), [one for one in _all_processes() if one.pid not in before])
        if not left:
            break
        killed.update(dict.fromkeys(_kill(left)))
        time.sleep(_ROUND_S)  # for those with other parents
    return list(killed)


def kill_adopted(before: Container[int]) -> list[ProcessInfo]:
    """Kill the adopted children of this process with their descendants, and return them.

    Args:
        before: pids of its earlier children.
    """
    adopted = [one.pid for one in descendants(os.getpid()) if one.parent == os.getpid() and one.pid not in before]
    below = {member.pid: member for pid in adopted for member in descendants(pid)}
    children = {one.pid: one for one in descendants(os.getpid()) if one.pid in adopted}
    return _kill([*children.values(), *below.values()])


def _kill(members: list[ProcessInfo]) -> list[ProcessInfo]:
    for member in members:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.kill(member.pid, signal.SIGKILL)
    for member in members:
        with contextlib.suppress(ChildProcessError):
            os.waitpid(member.pid, 0)
    return members


def _below(pid: int, candidates: Sequence[ProcessInfo], also: Container[int] = ()) -> list[ProcessInfo]:
    """Return the descendants of a process and of some others, with these others."""
    inside = {pid}
    while True:
        expanded = {one.pid for one in candidates if one.parent in inside or one.pid in also} | inside
        if expanded == inside:
            return [one for one in candidates if one.pid in inside and one.pid != pid]
        inside = expanded


def _all_processes() -> Iterator[ProcessInfo]:
    for name in os.listdir(_PROC) if _PROC.is_dir() else ():  # noqa: PTH208 - called often: names are enough
        member = _read_process(int(name)) if name.isdecimal() else None
        if member is not None:
            yield member


def _read_process(pid: int) -> ProcessInfo | None:
    stat_fields = _stat_fields(pid)
    if stat_fields is None or stat_fields[1][0] == _ZOMBIE:
        return None
    name, fields = stat_fields
    return ProcessInfo(pid, int(fields[1]), int(fields[2]), int(fields[3]), int(fields[19]), name)


def _stat_fields(pid: int) -> tuple[str, list[str]] | None:
    """Return a process's name and the fields of proc_pid_stat(5) from its state on; None if it has ended."""
    try:
        # Reads every process of the machine, often: a Path object would take longer than the read.
        with open(f"/proc/{pid}/stat", "rb", buffering=0) as file:  # noqa: PTH123
            text = file.read(_MOST_STAT).decode(errors="replace")
    except OSError:
        return None
    # The name is in parentheses and may hold any character, also parentheses and spaces.
    before, _, after = text.rpartition(")")
    return before.partition("(")[2], after.split()


def _proportional(pid: int) -> tuple[int, int]:
    """Return a process's proportional share of mapped memory, bytes, and the part of in-memory files."""
    try:
        text = (_PROC / str(pid) / "smaps_rollup").read_text(encoding="ascii", errors="replace")
        sizes = dict(line.split()[:2] for line in text.splitlines()[1:])
        return int(sizes["Pss:"]) * 1024, int(sizes.get("Pss_Shmem:", 0)) * 1024
    except (OSError, ValueError, KeyError):
        return resident_bytes(pid), 0


def _memory_files(pid: int) -> Iterator[tuple[tuple[int, int], int]]:
    """Yield device, inode and size, bytes, of a process's in-memory files."""
    memory = _memory_devices(pid)
    with contextlib.suppress(OSError):
        for name in os.listdir(_PROC / str(pid) / "fd"):  # noqa: PTH208 - called often
            with contextlib.suppress(OSError):
                status = os.stat(f"/proc/{pid}/fd/{name}")  # noqa: PTH116 - as above
                if stat.S_ISREG(status.st_mode) and status.st_dev in memory:
                    yield (status.st_dev, status.st_ino), 512 * status.st_blocks


def _memory_devices(pid: int) -> set[int]:
    """Return the devices of in-memory files: the kernel's own, and that of a process's `/dev/shm`."""
    devices = set()
    with contextlib.suppress(OSError, AttributeError):
        devices.add(_kernels_own())
    with contextlib.suppress(OSError):
        devices.add(os.stat(f"/proc/{pid}/root/dev/shm").st_dev)  # noqa: PTH116 - as above
    return devices


@cache
def _kernels_own() -> int:
    descriptor = os.memfd_create("xpl")
    try:
        return os.fstat(descriptor).st_dev
    finally:
        os.close(descriptor)
