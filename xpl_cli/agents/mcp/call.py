"""A call of a tool: the command runs in a process of its own, and ends with the call."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.basics import again
from xpl_cli.basics.errors import ExitCode

if TYPE_CHECKING:
    from anyio.abc import Process

_GRACE_S: Final = 10.0
"""What a command has, once it is told to end, to end what it started."""

_REMARKS: Final = 20
_ANSWERS: Final = frozenset((ExitCode.CLEAN, ExitCode.FINDINGS, ExitCode.NOT_RUN))


@dataclass(frozen=True)
class Answer:
    """What a command said.

    Attributes:
        code: its exit code.
        text: its standard output.
        remarks: the last lines of its standard error.
    """

    code: int
    text: str
    remarks: tuple[str, ...]

    @property
    def document(self) -> dict[str, Any] | None:
        """The answer as a map; None if it is none, or one of each of several runs."""
        with contextlib.suppress(ValueError):
            found = json.loads(self.text)
            return found if isinstance(found, dict) else None
        return None

    @property
    def is_error(self) -> bool:
        """Whether the command could not do what it was asked; findings are an answer."""
        return self.code not in _ANSWERS

    @property
    def about(self) -> str:
        """The exit code in words, then the remarks."""
        meanings = {int(code): code.meaning for code in ExitCode}
        return "\n".join([f"exit code {self.code} ({meanings.get(self.code, 'ended from outside')})", *self.remarks])


_running: set[Process] = set()
"""Commands of calls that have not ended."""


async def end_all() -> None:
    """End every command that runs, in order: what they started ends with them."""
    import anyio

    async with anyio.create_task_group() as group:
        for process in tuple(_running):
            group.start_soon(_end, process)


def kill_all() -> None:
    """End every command that runs at once."""
    for process in tuple(_running):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


async def run(arguments: Sequence[str], folder: Path, progress: Callable[[int, str], Awaitable[None]]) -> Answer:
    """Run a command of `xpl`.

    Args:
        arguments: of the command line.
        folder: working directory.
        progress: told each line of standard error, with its number, as it comes.

    Whoever cancels this ends the command, too, and what it started.
    """
    import anyio
    from anyio.streams.text import TextReceiveStream

    command = [*again.command("xpl_cli"), *arguments]
    # Standard input is the protocol's: a command must not read it.
    process = await anyio.open_process(command, cwd=folder, stdin=subprocess.DEVNULL, start_new_session=True)
    _running.add(process)
    pipes = [pipe for pipe in (process.stdout, process.stderr) if pipe is not None]
    said, noted = (TextReceiveStream(pipe, errors="replace") for pipe in pipes)
    remarks: list[str] = []

    async def listen() -> None:
        rest = ""
        async for piece in noted:
            *lines, rest = (rest + piece).split("\n")
            for line in lines:
                remarks.append(line)
                await progress(len(remarks), line)
        remarks.extend([rest] if rest else [])

    try:
        async with anyio.create_task_group() as group:
            group.start_soon(listen)
            output = [piece async for piece in said]
        code = await process.wait()
    finally:
        with anyio.CancelScope(shield=True):
            await _end(process)
        _running.discard(process)
    return Answer(code, "".join(output), tuple(remarks[-_REMARKS:]))


async def _end(process: Process) -> None:
    """End a command that still runs: first as Ctrl-C would, so that it tidies up."""
    import anyio

    for number in (signal.SIGTERM, signal.SIGKILL):
        if process.returncode is not None:
            break
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with anyio.move_on_after(_GRACE_S):
            await process.wait()
    await process.aclose()
