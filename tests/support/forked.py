"""The command line in processes of its own, forked from one that has imported everything: a tenth of a start anew.

It is the fork server that audits start their policy servers with (`xpl_cli.serving.fork_server`), with every command in
it; its own tests hold that a forked command differs in nothing. What a command inherits instead of importing is all
that is left out: where imports, the interpreter's own variables or its start are the subject, tests start
`python -m xpl_cli`.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import importlib
import os
import pkgutil
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NoReturn
from unittest import mock

import xpl_cli
from tests.support.checkout import ROOT
from xpl_cli.serving import fork_server

_START: Final = (
    "import sys; sys.path.insert(0, sys.argv[1]); from tests.support import forked; forked.main(sys.argv[2])"
)
_LIBRARIES: Final = ("copier", "jinja2", "jsonschema", "jsonschema_rs", "numpy", "rich.progress", "rich.table")
"""What commands import when they need it."""
_WITH_SERVERS: Final = frozenset({"audit", "demo", "eval", "review", "submit", "verify"})
_AT_FIRST: Final[dict[str, str]] = {}
"""Variables that it is started with, whichever test asks first."""


def run(
    *arguments: str | Path, cwd: Path | None = None, env: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run `xpl` with arguments in a process of its own, with nothing to read, and return how it ended.

    Args:
        arguments: the command line after `xpl`.
        cwd: its working directory; ours by default.
        env: its variables; ours by default.
    """
    words = [str(argument) for argument in arguments]
    folder = contextlib.nullcontext() if cwd is None else contextlib.chdir(cwd)
    with folder, mock.patch.dict(os.environ, env or os.environ, clear=True):
        if _of_interpreter(os.environ) != _of_interpreter(_AT_FIRST):
            return anew(*words)
        hosted = _commands().start(words)
    hosted.stdin.close()
    errors: list[bytes] = []
    reader = threading.Thread(target=lambda: errors.append(hosted.stderr.read()))
    reader.start()
    output = hosted.stdout.read()
    reader.join()
    code = hosted.wait()
    hosted.stdout.close()
    hosted.stderr.close()
    return subprocess.CompletedProcess(["xpl", *words], code, output.decode(), errors[0].decode())


def anew(*arguments: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run `xpl` by an interpreter of its own, where what that imports is the subject."""
    command = [sys.executable, "-m", "xpl_cli", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)


def remember() -> None:
    """Keep the variables as they are now, before any test changes them, for the process that is forked."""
    _AT_FIRST.update(os.environ)


def _of_interpreter(variables: Mapping[str, str]) -> dict[str, str]:
    """Return what an interpreter reads once, when it starts."""
    return {name: value for name, value in variables.items() if name.startswith("PYTHON")}


@functools.cache
def _commands() -> fork_server.ForkServer:
    with contextlib.chdir(ROOT), mock.patch.dict(os.environ, _AT_FIRST, clear=True):
        made = fork_server.ForkServer(_START)
    atexit.register(made.close)
    return made


def main(descriptor: str) -> None:
    """Fork the commands that the process at the other end of a socket asks for."""
    names = [module.name for module in pkgutil.walk_packages(xpl_cli.__path__, "xpl_cli.")]
    for name in (*names, *_LIBRARIES):
        if not name.endswith("__main__"):
            with contextlib.suppress(ImportError):  # an extra that is not there
                importlib.import_module(name)
    become = fork_server._run_child

    def with_fork_server(channel: socket.socket, order: Mapping[str, Any], descriptors: Sequence[int]) -> NoReturn:
        channel.close()
        if _WITH_SERVERS.intersection(order["arguments"][:1]):
            made = _Forked(descriptors)
            atexit.register(made.close)
            fork_server._fork_server = lambda _pid: made  # type: ignore[assignment]
        become(channel, order, descriptors)

    fork_server._run_child = with_fork_server
    fork_server.main(int(descriptor))


class _Forked(fork_server.ForkServer):
    """The fork server of a forked command: itself, before it has begun, and not a process that imports all again."""

    def __init__(self, descriptors: Sequence[int]) -> None:
        self._lock = threading.Lock()
        self._channel, theirs = socket.socketpair()
        self._link = fork_server.Channel(self._channel)
        self._process = _Child(os.fork())  # type: ignore[assignment]
        if self._process.pid:
            theirs.close()
            return
        self._channel.close()
        for descriptor in descriptors:
            os.close(descriptor)
        os.setsid()
        fork_server.main(theirs.fileno())
        os._exit(0)


class _Child:
    def __init__(self, pid: int) -> None:
        self.pid = pid

    def wait(self) -> None:
        os.waitpid(self.pid, 0)
