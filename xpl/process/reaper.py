"""Reaper: the process above a worker, which kills everything that the worker started when the worker ends.

    python -I -S reaper.py WORKER LINK

A worker forks as its first act: the child goes on as the worker, the parent becomes this. What the worker's processes
leave behind becomes a child of this one (prctl(2), PR_SET_CHILD_SUBREAPER), whatever group or session it made for
itself. When the other end of the link is closed, for example because the server was killed, or when the worker has
ended, all of it is killed; a worker that is stopped, or that never gives another thread a turn, cannot prevent it. Then
this process ends as the worker did. Standard library only; this file is run by itself, so that it starts fast.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import time
from typing import NoReturn

_PROC = "/proc"
_SET_PARENT_DEATH_SIGNAL, _SET_CHILD_SUBREAPER = 1, 36
_GONE = select.POLLHUP | select.POLLERR | select.POLLNVAL
_AGAIN_S = 0.005


def main(worker: int, link: int) -> NoReturn:
    """Wait until the worker ends or the link is closed; then kill all descendants."""
    wakes, woken = os.pipe()
    os.set_blocking(woken, False)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # meant for the server, which ends this process in order
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(woken, warn_on_full_buffer=False)
    become_subreaper()
    poll = select.poll()
    poll.register(link, 0)  # POLLHUP is always reported
    poll.register(wakes, select.POLLIN)
    status = None
    while status is None:
        status = _reap(worker)
        if status is None and any(number == link and event & _GONE for number, event in poll.poll()):
            break
        while select.select([wakes], [], [], 0)[0]:
            os.read(wakes, 4096)
    _end_all(worker)
    _end_as(status or 0)


def become_subreaper() -> None:
    """Become the parent of orphaned descendants; get SIGCONT when the server ends, should this process be stopped."""
    if sys.platform != "linux":
        return
    with contextlib.suppress(ImportError, OSError, AttributeError):
        import ctypes

        prctl = ctypes.CDLL(None).prctl
        for option, value in ((_SET_CHILD_SUBREAPER, 1), (_SET_PARENT_DEATH_SIGNAL, int(signal.SIGCONT))):
            prctl(option, ctypes.c_ulong(value), *[ctypes.c_ulong(0)] * 3)


def _reap(worker: int) -> int | None:
    """Reap processes that have ended; return the status of the worker if it is one of them."""
    worker_status = None
    with contextlib.suppress(ChildProcessError):
        while True:
            pid, status = os.waitpid(-1, os.WNOHANG)
            if pid == 0:
                break
            if pid == worker:
                worker_status = status
    return worker_status


def _end_all(worker: int) -> None:
    """Kill all descendants of this process until none is left."""
    reported: set[int] = set()
    if not os.path.isdir(_PROC) and os.getpid() == os.getpgrp():  # noqa: PTH112 - pathlib starts slowly
        os.killpg(os.getpgrp(), signal.SIGKILL)  # this process, too: without /proc no other is visible
    while True:
        left = _descendants(os.getpid())
        if not left:
            return
        for pid, (name, group) in left.items():
            if pid != worker and group != os.getpgrp() and pid not in reported:
                reported.add(pid)
                with contextlib.suppress(OSError):
                    os.write(2, f"[worker] ended process {pid} ({name}), which had left the group\n".encode())
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(_AGAIN_S)
        _reap(worker)


def _descendants(pid: int) -> dict[int, tuple[str, int]]:
    """Return name and process group of the living descendants of a process, by process id."""
    processes: dict[int, tuple[int, str, int]] = {}
    for entry in os.listdir(_PROC) if os.path.isdir(_PROC) else ():  # noqa: PTH112, PTH208 - pathlib starts slowly
        if entry.isdigit():
            with contextlib.suppress(OSError, ValueError, IndexError):
                with open(f"{_PROC}/{entry}/stat", encoding="utf-8", errors="replace") as file:  # noqa: PTH123
                    before, _, after = file.read().rpartition(")")
                state, parent, group = after.split()[:3]
                if state != "Z":
                    processes[int(entry)] = int(parent), before.partition("(")[2], int(group)
    descendants: dict[int, tuple[str, int]] = {}
    inside = {pid}
    while inside:
        inside = {one for one, (parent, _, _) in processes.items() if parent in inside and one not in descendants}
        descendants.update({one: processes[one][1:] for one in inside})
    return descendants


def _end_as(status: int) -> NoReturn:
    """End with the worker's exit code or signal."""
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        with contextlib.suppress(ImportError, OSError, ValueError):
            import resource

            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # one core dump of a crash is enough
        if number != signal.SIGKILL:
            signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    os._exit(os.WEXITSTATUS(status) if os.WIFEXITED(status) else 1)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
