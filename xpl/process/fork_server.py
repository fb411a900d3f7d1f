"""A process that has imported the libraries of a policy, and forks processes that run a module of the SDK.

Importing a model's libraries takes up to 20 s, and an audit starts dozens of processes of one policy. This process
imports what the first one imported, and each fork starts where these imports end: it imports the adapter's own modules
and loads the model as every other process does. Standard library only; Linux.

It gets connections over a control socket, a byte with one descriptor each, and ends when that is closed. On a
connection (`xpl.process.link`):

    -> {"import": {"modules": [[name, file], ...], "variables": {name: value}}}
    -> {"run": module, "arguments": [...], "variables": {...}, "cwd": folder, "descriptors": n}    calls its `main`
    <- {"forks": true}                      or false: the process must be started in the usual way
    -> one byte, with n + 3 descriptors: a socket, standard input, output, further arguments of `main`
    <- {"code": 0}                          once it has ended; a process has a connection of its own

The process sends a byte over the socket, whose credentials tell the other end its process id, and is killed with all
that it started when the other end is closed (`xpl.process.reaper`).
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import importlib.util
import os
import selectors
import signal
import socket
import sys
import time
import traceback
from collections.abc import Iterable, Mapping, Sequence
from types import ModuleType
from typing import Any, NoReturn, Optional

from xpl.process import reaper
from xpl.process.link import Channel, Head, decode

START = "from xpl.process.fork_server import main; main(int(sys.argv[2]))"
"""Code that runs it, after `xpl.process.child.SDK_START`."""
_TASKS = "/proc/self/task"
_OWN_DESCRIPTORS = 3
_STARTED = time.time()


def imports() -> list[tuple[str, str]]:
    """Return name and file of all modules that this process has imported from files, in their order.

    Files that were written since it started are left out: libraries generate modules in temporary folders.
    """
    found = ((name, _file(module)) for name, module in list(sys.modules.items()) if name != "__main__")
    return [
        (name, file)
        for name, file in found
        if file
        and os.path.isfile(file)  # noqa: PTH113 - fast
        and os.stat(file).st_mtime < _STARTED  # noqa: PTH116 - fast
    ]


def main(control: int) -> NoReturn:
    """Serve connections that arrive over a control socket until it is closed."""
    with open(os.devnull, "r+b") as nothing:  # noqa: PTH123 - a device: nobody reads what libraries print
        for number in range(3):
            os.dup2(nothing.fileno(), number)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _ForkServer(socket.socket(fileno=control)).serve()
    os._exit(0)


class _ForkServer:
    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._usable = False
        self._connections: dict[socket.socket, Channel] = {}
        self._running: dict[int, Channel] = {}

    def serve(self) -> None:
        """Handle connections until the control socket is closed."""
        wakes, woken = os.pipe()
        os.set_blocking(woken, False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(woken, warn_on_full_buffer=False)
        with selectors.DefaultSelector() as ready:
            ready.register(self._control, selectors.EVENT_READ)
            ready.register(wakes, selectors.EVENT_READ)
            while True:
                for key, _ in ready.select():
                    if key.fileobj is self._control:
                        _, received, _, _ = socket.recv_fds(self._control, 1, 1)
                        if not received:
                            return
                        connection = socket.socket(fileno=received[0])
                        self._connections[connection] = Channel(connection)
                        ready.register(connection, selectors.EVENT_READ)
                    elif key.fileobj == wakes:
                        os.read(wakes, 4096)
                        self._report_ended()
                    elif isinstance(key.fileobj, socket.socket) and not self._answer(key.fileobj):
                        ready.unregister(key.fileobj)
                        del self._connections[key.fileobj]
                        key.fileobj.close()

    def _answer(self, connection: socket.socket) -> bool:
        """Handle one message; return False at the end of the connection."""
        channel = self._connections[connection]
        message = channel.receive()
        if message is None:
            return False
        request: Head = decode(message)[0]
        if "import" in request:
            self._usable = _import(**request["import"])
            return True
        channel.send({"forks": self._usable})
        if self._usable:
            received = socket.recv_fds(connection, 1, _OWN_DESCRIPTORS + request["descriptors"])[1]
            pid = os.fork()
            if pid == 0:
                self._become(request, received)
            self._running[pid] = channel
            for number in received:
                os.close(number)
        return True

    def _report_ended(self) -> None:
        with contextlib.suppress(ChildProcessError):
            while True:
                pid, status = os.waitpid(-1, os.WNOHANG)
                if pid == 0:
                    return
                channel = self._running.pop(pid, None)
                if channel is not None:
                    with contextlib.suppress(OSError):  # nobody waits for it
                        channel.send({"code": os.waitstatus_to_exitcode(status)})

    def _become(self, request: Head, received: Sequence[int]) -> NoReturn:
        """Run the module of a request in this forked process."""
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        for one in (self._control, *self._connections):
            one.close()
        os.setsid()
        life, stdin, output, *descriptors = received
        os.write(life, b"\0")
        _put_reaper_above(life)
        for number, received_as in enumerate((stdin, output, output)):
            os.dup2(received_as, number)
        os.close(stdin)
        os.close(output)
        os.environ.update(request["variables"])
        os.chdir(request["cwd"])
        if "numpy" in sys.modules:  # as in a process that was started: nothing is seeded (`random` sees to it itself)
            sys.modules["numpy"].random.seed()
        try:
            importlib.import_module(request["run"]).main(*request["arguments"], *descriptors)
        except BaseException:  # noqa: BLE001 - as the interpreter does
            traceback.print_exc()
            sys.stderr.flush()
        os._exit(1)


def _put_reaper_above(life: int) -> None:
    """Fork: the child goes on, and this process becomes its reaper."""
    reaper.become_subreaper()  # kept by exec; the worker may start others and end before the reaper has started
    worker = os.fork()
    if worker:
        os.set_inheritable(life, True)  # noqa: FBT003 - positional only
        os.execv(sys.executable, [sys.executable, "-I", "-S", str(reaper.__file__), str(worker), str(life)])  # noqa: S606
    os.close(life)


def _import(modules: Iterable[tuple[str, str]], variables: Mapping[str, str]) -> bool:
    """Import modules; return whether this process may be forked.

    Args:
        modules: name and file of each. The adapter's own, below the working directory, are left out, and so is one that
            would come from another file here, since the adapter changes the path, with what is below it.
        variables: environment variables that were set when they were imported.
    """
    os.environ.update(variables)
    # Asking the CUDA runtime whether there is a device starts threads. Source: PyTorch, CUDA environment variables.
    os.environ.setdefault("PYTORCH_NVML_BASED_CUDA_CHECK", "1")
    expected = dict(modules)
    adapter = os.getcwd() + os.sep  # noqa: PTH109 - compared as text
    refused: set[str] = set()
    for name, file in expected.items():
        above = name.rpartition(".")[0]
        if above in refused or file.startswith(adapter) or not _import_from(name, file):
            refused.add(name)
    importlib.invalidate_caches()
    gc.collect()
    gc.freeze()
    # Another of that name, which a library imported: a fork would not import the one that the adapter provides.
    is_same = all(
        _file(module) in (expected.get(name), None) for name, module in sys.modules.items() if name in expected
    )
    return is_same and _threads() == _openblas_threads()


def _threads() -> int:
    """Return how many threads this process has besides its first; those of jemalloc may be forked (`jemalloc(3)`)."""
    threads = 0
    for task in os.listdir(_TASKS):  # noqa: PTH208 - as below
        with open(f"{_TASKS}/{task}/comm", encoding="utf-8", errors="replace") as name:  # noqa: PTH123
            threads += not name.read().startswith("jemalloc")
    return threads - 1


def _openblas_threads() -> int:
    """Return how many threads OpenBLAS has started.

    Only a process without threads can be forked; OpenBLAS ends its own before a fork, and starts them again after it.
    """
    with open("/proc/self/maps", encoding="utf-8", errors="replace") as maps:  # noqa: PTH123 - as elsewhere here
        libraries = {line.split()[-1] for line in maps if "openblas" in line.rpartition("/")[2]}
    threads = 0
    for path in libraries:
        library = ctypes.CDLL(path)
        names = (f"{before}openblas_get_num_threads{after}" for before in ("scipy_", "") for after in ("64_", ""))
        ask = next((getattr(library, name) for name in names if hasattr(library, name)), None)
        threads += 0 if ask is None else ask() - 1
    return threads


def _import_from(name: str, file: str) -> bool:
    try:
        if name not in sys.modules:
            found = importlib.util.find_spec(name)
            if found is None or found.origin != file:
                return False
            importlib.import_module(name)
    except BaseException:  # noqa: BLE001 - whatever a library raises: then each fork imports it
        return False
    return True


def _file(module: Optional[ModuleType]) -> Any:  # noqa: UP045 - Python 3.9
    return getattr(getattr(module, "__spec__", None), "origin", None)
