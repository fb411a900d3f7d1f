"""A process of our own that answers messages over a private descriptor: how it starts, serves, ends with its parent.

Standard library only. Workers of policies (`xpl.worker.main`) and of environments (`xpl.simulator.worker`), and the
processes that run an adapter's evaluation loop (`xpl.loop.worker`), are such processes.
"""

from __future__ import annotations

import faulthandler
import io
import os
import select
import signal
import socket
import sys
import threading
import traceback
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Callable, NoReturn

from xpl.process import link
from xpl.process.link import Channel, Head
from xpl.wire.frame import PackingError

if TYPE_CHECKING:
    from xpl.wire.arrays import Data

    Handle = Callable[[Head, Sequence[memoryview]], tuple[Head, list[Data]]]

SDK_START = """
import importlib.util, sys
sys.path[:] = [p for p in sys.path if p]
folder = sys.argv[1]
found = importlib.util.spec_from_file_location("xpl", folder + "/__init__.py", submodule_search_locations=[folder])
module = sys.modules["xpl"] = importlib.util.module_from_spec(found)
found.loader.exec_module(module)
"""
"""Makes `import xpl` work in any interpreter without putting a folder on its path: nothing but the SDK becomes
importable. Its first argument is the SDK's folder; further code may follow. Python 3.9, standard library."""

KEPT_START = """
import os, sys
if sys.executable:
    _worker = os.fork()
    if _worker:
        _keeper = [sys.executable, "-I", "-S", sys.argv[1] + "/process/keeper.py", str(_worker), sys.argv[2]]
        os.execv(_keeper[0], _keeper)
"""
"""Puts a keeper (`xpl.process.keeper`) above this process; comes before `SDK_START`. Its second argument is the number
of its end of the link."""


TURN_S = 1.0
"""How long the main thread has to come back from foreign code before another one lets go of what is held."""
LEAVE_S = 5.0
"""How long letting go may take."""


class _Ended(BaseException):
    """This process was asked to end; nothing between here and the loop of messages is to catch it."""


class Leaving:
    """What is to be done once before this process ends, by whichever thread gets there first.

    Args:
        leave: lets go of what is held: an arm holds its pose, a simulator closes its files.
    """

    def __init__(self, leave: Callable[[], None]) -> None:
        self._leave = leave
        self._turn = threading.Lock()
        self._begun = threading.Event()
        self._done = threading.Event()

    def run(self) -> None:
        """Let go, unless that has been done; return when it is done, or takes too long."""
        if not self._turn.acquire(blocking=False):
            self._done.wait(LEAVE_S)
            return
        self._begun.set()
        try:
            self._leave()
        except BaseException:  # noqa: BLE001 - it is the last thing that happens here
            sys.stderr.write(traceback.format_exc())
        finally:
            self._done.set()

    def see_to_it(self) -> None:
        """See that it happens although the main thread may be stuck, and return when it has, or takes too long."""
        if not self._begun.wait(TURN_S):
            threading.Thread(target=self.run, daemon=True).start()
        self._done.wait(LEAVE_S)


def serve(descriptor: int, handle: Handle, leave: Callable[[], None] | None = None) -> NoReturn:
    """Answer messages that arrive on a descriptor until it is closed, then end.

    Args:
        descriptor: our end of a socket pair (`joined`).
        handle: returns head and buffers of the answer to the head and the buffers of a message.
        leave: is called once before the process ends: when the parent is gone, when it closes the link, and on SIGTERM;
            where the main thread does not come back from `handle`, by another thread.
    """
    leaving = None if leave is None else Leaving(leave)
    try:
        stream = joined(descriptor, leaving)
        _answer(stream, handle)
    except PackingError as error:
        sys.stderr.write(f"[worker] {error}\n")
    except (OSError, _Ended):
        pass
    if leaving is not None:
        leaving.run()
    end()


def _answer(stream: Channel, handle: Handle) -> None:
    while True:
        message = stream.receive()
        if message is None:
            return
        answer = handle(*link.decode(message))
        del message  # what it holds may be large, and the next one may be long in coming
        stream.send(*answer)


def joined(descriptor: int, leaving: Leaving | None = None) -> Channel:
    """Return the link to the parent, and prepare this process for it.

    What runs here may print: standard output is joined to standard error, so the link stays clean, and nothing fails
    for want of a reader when the parent is gone: least of all an arm that says that it stops. A thread watches the
    link, so that the process ends with its parent even while it computes. SIGUSR1 prints where it is.

    Args:
        descriptor: our end of a socket pair.
        leaving: what is to be done before the process ends; SIGTERM is waited for then, too.
    """
    os.dup2(2, 1)
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(
            io.BufferedWriter(_Output(number, "w", closefd=False)), "utf-8", "backslashreplace", line_buffering=True
        )
        for number in (1, 2)
    )
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent, which ends this process in order
    faulthandler.register(signal.SIGUSR1, all_threads=True)
    os.set_inheritable(descriptor, False)  # noqa: FBT003 - positional only
    channel = socket.socket(fileno=descriptor)
    channel.settimeout(None)
    threading.Thread(target=_watch, args=(descriptor, leaving), daemon=True).start()
    if leaving is not None:
        _end_on_sigterm(leaving)
    return Channel(channel)


class _Output(io.FileIO):
    """A descriptor whose reader may go: what is written then is dropped."""

    def write(self, data: Any, /) -> int:
        """Write, or drop."""
        try:
            return super().write(data)
        except BrokenPipeError:
            return memoryview(data).nbytes


def _watch(descriptor: int, leaving: Leaving | None) -> None:
    """Wait until the other end of the link is closed."""
    poll = select.poll()
    poll.register(descriptor, 0)  # a hang-up is reported unasked
    while not any(event & (select.POLLHUP | select.POLLERR | select.POLLNVAL) for _, event in poll.poll()):
        pass
    _leave(leaving)


def _leave(leaving: Leaving | None) -> NoReturn:
    """Let go of what is held, and end."""
    if leaving is not None:
        leaving.see_to_it()
    end()


def _end_on_sigterm(leaving: Leaving) -> None:
    def told(_number: int, _frame: object) -> NoReturn:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        threading.Thread(target=_leave, args=(leaving,), daemon=True).start()
        raise _Ended

    signal.signal(signal.SIGTERM, told)


def end() -> NoReturn:
    """End at once, with all child processes: the parent is gone, the main thread may be deep inside foreign code."""
    if os.getpid() == os.getpgrp():  # the parent starts this process as the leader of a group of its own
        os.killpg(os.getpgrp(), signal.SIGKILL)
    os._exit(0)
