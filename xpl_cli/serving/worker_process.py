"""The worker's process, seen from the front end: start, one request at a time, end."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import sys
from pathlib import Path
from typing import Any

import xpl
from xpl import link

# Makes `import xpl` work in any interpreter without putting a folder on its path: nothing but the SDK becomes
# importable. Python 3.9, standard library.
_BOOTSTRAP = """
import importlib.util, sys
sys.path[:] = [p for p in sys.path if p]
folder, fd = sys.argv[1], int(sys.argv[2])
found = importlib.util.spec_from_file_location("xpl", folder + "/__init__.py", submodule_search_locations=[folder])
module = sys.modules["xpl"] = importlib.util.module_from_spec(found)
found.loader.exec_module(module)
from xpl.worker import main
main(fd)
"""


class WorkerError(Exception):
    """The adapter raised.

    Args:
        kind: type name of the adapter's exception.
        message: its message.
        trace: its traceback, for the log only.
        unserialisable: the adapter answered, but its answer cannot travel.
    """

    def __init__(self, kind: str, message: str, trace: str, *, unserialisable: bool = False) -> None:
        super().__init__(message)
        self.kind = kind
        self.trace = trace
        self.unserialisable = unserialisable


class WorkerDiedError(Exception):
    """The worker's process ended before it answered."""


class WorkerProcess:
    """One adapter in a process of its own. Requests are answered in the order in which they were made."""

    def __init__(self, process: asyncio.subprocess.Process, channel: socket.socket) -> None:
        self._process = process
        self._channel = channel
        self._turn = asyncio.Lock()
        self._output = asyncio.create_task(self._copy_output())

    @classmethod
    async def start(cls, python: str, *, cwd: Path, gpu: str | None = None) -> WorkerProcess:
        """Start a worker in the interpreter `python`; it loads nothing yet."""
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
        # The tool's own path settings must not leak into the policy's interpreter.
        environment.pop("PYTHONHOME", None)
        if gpu is not None:
            environment["CUDA_VISIBLE_DEVICES"] = gpu
        sdk = str(Path(xpl.__file__).parent)
        with theirs:
            process = await asyncio.create_subprocess_exec(
                python,
                "-c",
                _BOOTSTRAP,
                sdk,
                str(theirs.fileno()),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
                pass_fds=[theirs.fileno()],
                env=environment,
                cwd=cwd,
                start_new_session=True,  # a group of its own, so that its children end with it
            )
        return cls(process, ours)

    async def request(self, **request: Any) -> Any:
        """Send one request and return the adapter's result.

        Raises:
            WorkerError: if the adapter raised.
            WorkerDiedError: if the process ended.
        """
        async with self._turn:
            try:
                await self._send(request)
                answer = await self._receive()
            except (OSError, EOFError):
                raise WorkerDiedError(await self._last_words()) from None
        if "error" in answer:
            error = answer["error"]
            unserialisable = bool(error.get("unserialisable"))
            raise WorkerError(error["type"], error["message"], error["traceback"], unserialisable=unserialisable)
        return answer["ok"]

    async def stop(self, grace: float) -> None:
        """End the worker and all its children: close the link, wait `grace` seconds, then kill the group."""
        self._channel.close()
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._process.wait(), grace)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        await self._process.wait()
        await self._output

    async def _send(self, request: dict[str, Any]) -> None:
        loop = asyncio.get_running_loop()
        for piece in link.encode(request):
            await loop.sock_sendall(self._channel, piece)

    async def _receive(self) -> Any:
        prefix = await self._exactly(4)
        tree, sizes = link.parse_header(await self._exactly(link.header_length(bytes(prefix))))
        buffers = [memoryview(await self._exactly(size)) for size in sizes]
        return link.decode(tree, buffers)

    async def _exactly(self, size: int) -> bytearray:
        loop = asyncio.get_running_loop()
        data = bytearray(size)
        view = memoryview(data)
        while view:
            count = await loop.sock_recv_into(self._channel, view)
            if not count:
                raise EOFError
            view = view[count:]
        return data

    async def _copy_output(self) -> None:
        """Show what the adapter prints on our standard error; nobody else writes there mid-line."""
        stream = self._process.stdout
        while stream is not None and (chunk := await stream.read(65536)):
            sys.stderr.write(chunk.decode(errors="replace"))
            sys.stderr.flush()

    async def _last_words(self) -> str:
        try:
            code = await asyncio.wait_for(self._process.wait(), 5)
        except TimeoutError:
            return "the worker closed its link but still runs"
        if code < 0:
            return f"the worker was ended by signal {signal.Signals(-code).name}"
        return f"the worker ended with exit code {code}"
