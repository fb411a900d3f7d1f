"""The processes of an adapter: which there are, what memory they hold, and the end of those that broke away.

Read from /proc; where the system has none, there are no processes to be seen.
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
"""Bytes; what proc_pid_stat(5) tells of a process has never a fifth of it."""
_ZOMBIE, _STOPPED = "Z", "T"
_ROUNDS, _ROUND_S = 200, 0.005
"""How often, and how long after each other, processes are ended that may start others while they are."""
LAUNCHERS = 2
"""Processes above a command that is kept apart (`launch.py`; bubblewrap's are as many)."""


@dataclass(frozen=True)
class ProcessInfo:
    """A process.

    Attributes:
        pid: its number.
        parent: the process that started it, or adopted it.
        group: its process group; a worker leads one of its own.
        session: its session.
        started: when it started, in the system's ticks; with the number, it names a process for good.
        name: what it runs, in at most 15 characters.
    """

    pid: int
    parent: int
    group: int
    session: int
    started: int
    name: str

    @property
    def command(self) -> str:
        """Its command line, in at most 80 characters."""
        with contextlib.suppress(OSError):
            words = (_PROC / str(self.pid) / "cmdline").read_bytes().decode(errors="replace").split("\0")
            return " ".join(word for word in words if word)[:80] or self.name
        return self.name

    @property
    def is_alive(self) -> bool:
        """Whether it has not ended yet."""
        found = _read_process(self.pid)
        return found is not None and found.started == self.started


def descendants(pid: int) -> list[ProcessInfo]:
    """Return the processes below one, children of children too, and those of the session that it began."""
    known = list(_all_processes())
    # Not those of its group: in a pipeline that is the user's, and its other commands are in it. A session is never
    # joined, only inherited.
    return _below(pid, known, {one.pid for one in known if one.session == pid})


def tree_pids(pid: int) -> list[int]:
    """Return the numbers of a process and of those below it."""
    return [pid, *(member.pid for member in descendants(pid))]


def launcher_chain(pid: int) -> list[int]:
    """Return a launcher of a command that is kept apart, the first process of its namespace, and the command.

    The list ends with what there is so far: one that has just been started has nothing below it.
    """
    return first_descendants(pid, LAUNCHERS)


def first_descendants(pid: int, levels: int) -> list[int]:
    """Return a process, the first that it started, the first that this one started, and so on."""
    known, chain = list(_all_processes()), [pid]
    while len(chain) <= levels:
        children = [member for member in known if member.parent == chain[-1]]
        if not children:
            break
        # What it adopts later came later.
        chain.append(min(children, key=lambda member: (member.started, member.pid)).pid)
    return chain


@dataclass(frozen=True)
class Activity:
    """What one process has done: processor time in the system's ticks, bytes read and written; whether it rests."""

    ticks: int = 0
    moved: int = 0
    stopped: bool = False


def activity(pid: int) -> Activity:
    """Return what a process has done so far; nothing where the system does not tell."""
    fields = _stat_fields(pid)
    if fields is None:
        return Activity()
    moved = 0
    with contextlib.suppress(OSError, ValueError):
        lines = (_PROC / str(pid) / "io").read_text(encoding="ascii").splitlines()
        moved = sum(int(line.split()[1]) for line in lines if line.startswith(("rchar", "wchar")))
    return Activity(int(fields[1][11]) + int(fields[1][12]), moved, fields[1][0] == _STOPPED)


def resident_bytes(pid: int) -> int:
    """Return the resident memory of one process, bytes; 0 where the system does not tell."""
    try:
        return int((_PROC / str(pid) / "statm").read_text(encoding="ascii").split()[1]) * _PAGE
    except (OSError, IndexError, ValueError):
        return 0


def private_bytes(pid: int) -> int | None:
    """Return the memory that a process has for itself, bytes; None where the system does not tell."""
    try:
        status = (_PROC / str(pid) / "status").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    line = next((line for line in status.splitlines() if line.startswith("RssAnon:")), None)
    return None if line is None else 1024 * int(line.split()[1])


def proportional_bytes(pid: int) -> int:
    """Return the memory that a process and those below it hold, bytes; a page that they share counts once.

    That is what they have mapped, and files that lie in memory; these are often mapped too, so that of both sums the
    larger one counts. Takes the system some milliseconds for a large process.
    """
    pids = tree_pids(pid)
    sizes = [_proportional(one) for one in pids]
    shared = sum(of_files for _, of_files in sizes)
    return sum(mapped for mapped, _ in sizes) - shared + max(shared, memory_file_bytes(pids))


def memory_file_bytes(pids: Iterable[int]) -> int:
    """Return the bytes of files that lie in memory and that processes have open (`memfd_create`, `/dev/shm`)."""
    return sum({place: size for pid in pids for place, size in _memory_files(pid)}.values())


def adopt_orphans() -> None:
    """Become the parent of whatever processes below this one lose theirs, so that none gets out of sight."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, ctypes.c_ulong(1), *[ctypes.c_ulong(0)] * 3)


def kill_tree(leader: int) -> None:
    """Kill the leader of a group, its group and the processes below it."""
    for number in tree_pids(leader):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.kill(number, signal.SIGKILL)
    spawn.end_group(leader)  # all that can be seen where there is no /proc


def kill_descendants(before: Container[int]) -> list[ProcessInfo]:
    """Kill the processes below this one, until there are none, and return them.

    Args:
        before: numbers of those that this process had when it began, such as the reader of its output, which a shell
            started before it became this process; they and theirs are spared.
    """
    killed: dict[ProcessInfo, None] = {}
    for _ in range(_ROUNDS):
        left = _below(os.getpid(), [one for one in _all_processes() if one.pid not in before])
        if not left:
            break
        killed.update(dict.fromkeys(_kill(left)))
        time.sleep(_ROUND_S)  # for those whose parent is another one
    return list(killed)


def kill_adopted(before: Container[int]) -> list[ProcessInfo]:
    """Kill the processes that this one has got as children, with all below them, and return them.

    Args:
        before: numbers of those that it had already.
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
    """Return the processes below one and below some others, with these others."""
    inside = {pid}
    while True:
        found = {one.pid for one in candidates if one.parent in inside or one.pid in also} | inside
        if found == inside:
            return [one for one in candidates if one.pid in inside and one.pid != pid]
        inside = found


def _all_processes() -> Iterator[ProcessInfo]:
    for name in os.listdir(_PROC) if _PROC.is_dir() else ():  # noqa: PTH208 - many, and often: names are enough
        member = _read_process(int(name)) if name.isdecimal() else None
        if member is not None:
            yield member


def _read_process(pid: int) -> ProcessInfo | None:
    found = _stat_fields(pid)
    if found is None or found[1][0] == _ZOMBIE:
        return None
    name, fields = found
    return ProcessInfo(pid, int(fields[1]), int(fields[2]), int(fields[3]), int(fields[19]), name)


def _stat_fields(pid: int) -> tuple[str, list[str]] | None:
    """Return a process's name and the fields of proc_pid_stat(5) from its state on; None if it is gone."""
    try:
        # Every process of the machine is read, and often: a path takes longer to make than the file to read.
        with open(f"/proc/{pid}/stat", "rb", buffering=0) as file:  # noqa: PTH123
            text = file.read(_MOST_STAT).decode(errors="replace")
    except OSError:
        return None
    # The name stands in parentheses and may hold any character, parentheses and spaces too.
    before, _, after = text.rpartition(")")
    return before.partition("(")[2], after.split()


def _proportional(pid: int) -> tuple[int, int]:
    """Return a process's share of what it has mapped, bytes, and what of it are files that lie in memory."""
    try:
        text = (_PROC / str(pid) / "smaps_rollup").read_text(encoding="ascii", errors="replace")
        sizes = dict(line.split()[:2] for line in text.splitlines()[1:])
        return int(sizes["Pss:"]) * 1024, int(sizes.get("Pss_Shmem:", 0)) * 1024
    except (OSError, ValueError, KeyError):
        return resident_bytes(pid), 0


def _memory_files(pid: int) -> Iterator[tuple[tuple[int, int], int]]:
    """Yield device, number and size, bytes, of the files of a process that lie in memory."""
    memory = _memory_devices(pid)
    with contextlib.suppress(OSError):
        for name in os.listdir(_PROC / str(pid) / "fd"):  # noqa: PTH208 - many, and often
            with contextlib.suppress(OSError):
                status = os.stat(f"/proc/{pid}/fd/{name}")  # noqa: PTH116 - as above
                if stat.S_ISREG(status.st_mode) and status.st_dev in memory:
                    yield (status.st_dev, status.st_ino), 512 * status.st_blocks


def _memory_devices(pid: int) -> set[int]:
    """Return the devices of files that lie in memory: the kernel's own, and that of a process's `/dev/shm`."""
    found = set()
    with contextlib.suppress(OSError, AttributeError):
        found.add(_kernels_own())
    with contextlib.suppress(OSError):
        found.add(os.stat(f"/proc/{pid}/root/dev/shm").st_dev)  # noqa: PTH116 - as above
    return found


@cache
def _kernels_own() -> int:
    descriptor = os.memfd_create("xpl")
    try:
        return os.fstat(descriptor).st_dev
    finally:
        os.close(descriptor)
