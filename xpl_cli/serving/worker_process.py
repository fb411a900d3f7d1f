"""The worker's process, seen from the front end: start, one request at a time, end."""

from __future__ import annotations

import asyncio
import codecs
import contextlib
import os
import signal
import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xpl
from xpl import link

if TYPE_CHECKING:
    from xpl.arrays import Data

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
        ours.settimeout(0.0)
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
            LinkError: if the request cannot travel; nothing was sent then.
            WorkerError: if the adapter raised.
            WorkerDiedError: if the process ended.
        """
        pieces = link.encode(request)
        async with self._turn:
            try:
                answer = await self._exchange(pieces)
            except (OSError, EOFError):
                raise WorkerDiedError(await self.ended()) from None
            except link.LinkError as error:
                self._channel.close()
                raise WorkerDiedError(f"the link to the worker broke: {error}") from None
            except asyncio.CancelledError:
                # Half an exchange: the next request would be given the answer to this one.
                self._channel.close()
                raise
        if "error" in answer:
            raised = answer["error"]
            unserialisable = bool(raised.get("unserialisable"))
            raise WorkerError(raised["type"], raised["message"], raised["traceback"], unserialisable=unserialisable)
        return answer["ok"]

    async def stop(self, grace: float) -> None:
        """End the worker and all its children: close the link, wait `grace` seconds, then kill the group."""
        self._channel.close()
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._process.wait(), grace)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        await self._process.wait()
        # What has left the group and still holds the pipe would keep it open for ever.
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._output, grace)

    async def ended(self) -> str:
        """Wait for the process to end and return how it did."""
        code = await self._process.wait()
        if code >= 0:
            return f"the worker ended with exit code {code}"
        names = {number.value: number.name for number in signal.Signals}
        return f"the worker was ended by signal {names.get(-code, -code)}"

    async def _exchange(self, pieces: list[Data]) -> Any:
        loop = asyncio.get_running_loop()
        for piece in pieces:
            await loop.sock_sendall(self._channel, piece)
        prefix = await self._exactly(link.PREFIX_BYTES)
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
        text = codecs.getincrementaldecoder("utf-8")(errors="replace")  # a chunk may end inside a character
        while stream is not None and (chunk := await stream.read(65536)):
            sys.stderr.write(text.decode(chunk))
            sys.stderr.flush()
