"""A process of our own that answers messages over a private descriptor: how it starts, serves, ends with its parent.

Standard library only. Workers of policies (`xpl.worker.main`) and of environments (`xpl.simulator.worker`), and the
processes that run an adapter's evaluation loop (`xpl.loop.worker`), are such processes.
"""

from __future__ import annotations

import faulthandler
import os
import select
import signal
import socket
import sys
import threading
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Callable, NoReturn

from xpl.process import link
from xpl.process.link import Channel

if TYPE_CHECKING:
    from xpl.wire.arrays import Data

    Handle = Callable[[Mapping[str, Any], Sequence[memoryview]], tuple[dict[str, Any], list[Data]]]

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


def serve(descriptor: int, handle: Handle) -> NoReturn:
    """Answer messages that arrive on a descriptor until it is closed, then end.

    Args:
        descriptor: our end of a socket pair (`joined`).
        handle: returns head and buffers of the answer to the head and the buffers of a message.
    """
    stream = joined(descriptor)
    try:
        while True:
            message = stream.receive()
            if message is None:
                end()
            answer = handle(*link.decode(message))
            del message  # what it holds may be large, and the next one may be long in coming
            stream.send(*answer)
    except link.LinkError as error:
        sys.stderr.write(f"[worker] {error}\n")
    except OSError:
        pass
    end()


def joined(descriptor: int) -> Channel:
    """Return the link to the parent, and prepare this process for it.

    What runs here may print: standard output is joined to standard error, so the link stays clean. A thread watches the
    link, so that the process ends with its parent even while it computes. SIGUSR1 prints where it is.

    Args:
        descriptor: our end of a socket pair.
    """
    os.dup2(2, 1)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent, which ends this process in order
    faulthandler.register(signal.SIGUSR1, all_threads=True)
    os.set_inheritable(descriptor, False)  # noqa: FBT003 - positional only
    channel = socket.socket(fileno=descriptor)
    channel.settimeout(None)
    threading.Thread(target=_watch, args=(descriptor,), daemon=True).start()
    return Channel(channel)


def _watch(descriptor: int) -> None:
    """Wait until the other end of the link is closed."""
    poll = select.poll()
    poll.register(descriptor, 0)  # a hang-up is reported unasked
    while not any(event & (select.POLLHUP | select.POLLERR | select.POLLNVAL) for _, event in poll.poll()):
        pass
    end()


def end() -> NoReturn:
    """End at once, with all child processes: the parent is gone, the main thread may be deep inside foreign code."""
    if os.getpid() == os.getpgrp():  # the parent starts this process as the leader of a group of its own
        os.killpg(os.getpgrp(), signal.SIGKILL)
    os._exit(0)
