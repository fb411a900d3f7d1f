"""Start a policy server in a process of its own, wait until it is ready, and end it reliably."""

from __future__ import annotations

import collections
import contextlib
import json
import selectors
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Self

from xpl import json_text
from xpl.process import spawn
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.serving import fork_server
from xpl_cli.serving.workers import forked
from xpl_cli.serving.workers.worker_answers import RAISED_AT, Frame, parse_frames

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from xpl.contract import Config
    from xpl_cli.isolation.forks import AdapterForkServer
    from xpl_cli.serving.fork_server import ForkedServer

STOP_S = 10.0
LOG_LINES = 400
LINE_BYTES = 1 << 16
"""Longest line of a log: an adapter may print without line ends."""
_ERROR = "error: "


@dataclass(frozen=True)
class MissingRequirement:
    """What a machine lacks, so that a model cannot load or answer there (`xpl.worker.missing_requirements`).

    Attributes:
        kind: such as `module` or `checkpoint`.
        name: which one.
    """

    kind: str
    name: str

    @classmethod
    def parse(cls, entry: object) -> Self | None:
        """Parse the entry of a worker's message; None if it is empty."""
        return cls(str(entry["kind"]), str(entry["name"])) if isinstance(entry, dict) and entry else None


class ServerStartError(UserError):
    """The server ended or timed out before it was ready.

    Attributes:
        reason: one sentence.
        log: last lines of its output.
        lacks: what the machine lacks, if that is why the model could not be loaded.
        raised_at: frames of the adapter's own files in its error, innermost first, if the server locates errors.
    """

    def __init__(
        self,
        reason: str,
        log: list[str],
        lacks: MissingRequirement | None = None,
        raised_at: tuple[Frame, ...] = (),
    ) -> None:
        super().__init__(reason, code=ExitCode.NOT_RUN)
        self.raised_at = raised_at
        self.reason = reason
        self.log = log
        self.lacks = lacks


@dataclass
class RunningServer:
    """A policy server that is ready.

    Attributes:
        url: its address.
        also: its addresses for other wires, by their names.
        pid: process of its front end.
        log: last lines that it and the adapter printed.
        stop_seconds: how long its shutdown took, s.
        token: its bearer token; None without one.
        process: process of its front end.
    """

    url: str
    pid: int
    log: collections.deque[str] = field(default_factory=lambda: collections.deque(maxlen=LOG_LINES))
    stop_seconds: float | None = None
    also: dict[str, str] = field(default_factory=dict)
    token: str | None = None
    process: ForkedServer | None = None

    @property
    def exit_code(self) -> int | None:
        """Exit code, None as long as it runs."""
        return None if self.process is None else self.process.poll()

    @property
    def last_error(self) -> str | None:
        """Its last printed error."""
        line = next((text for text in reversed(self.log) if text.startswith(_ERROR)), None)
        return None if line is None else line.removeprefix(_ERROR)


@contextlib.contextmanager
def running_server(  # noqa: PLR0913 - options of `xpl serve`
    policy: Path,
    overrides: Config | None = None,
    *,
    python: str | None = None,
    env: str | None = None,
    gpu: str | None = None,
    options: Sequence[str] = (),
    load_timeout: float = 600.0,
    echo: bool = False,
    token: str | None = None,
    on_start: Callable[[ForkedServer], object] | None = None,
    forks: AdapterForkServer | None = None,
) -> Iterator[RunningServer]:
    """Serve an adapter on a free loopback port for the length of a `with` block.

    Args:
        policy: folder of the adapter.
        overrides: keys of deploy.yml.
        python: interpreter of the adapter.
        env: environment of the adapter, as for `xpl serve --env`.
        gpu: device made visible to the adapter.
        options: further options of `xpl serve`.
        load_timeout: longest wait for the model, s.
        echo: also show the server's output on stderr.
        token: bearer token that it requires; None for no token.
        on_start: called with its process, before the model is loaded.
        forks: the fork server of its worker.

    Raises:
        ServerStartError: if it does not become ready.
    """
    command = ["serve", str(policy), "--port", "0", "--host", "localhost"]
    # If this process is killed, its end of the server's standard input closes, and the server ends too.
    command.append("--until-stdin-ends")
    for key, value in (overrides or {}).items():
        command += ["--set", f"{key}={json.dumps(value)}"]
    for option, value in (("--python", python), ("--policy-env", env), ("--gpu", gpu)):
        command += [option, value] if value is not None else []
    command += options
    with contextlib.ExitStack() as starting:
        command += starting.enter_context(_token_options(token))
        connection = None if forks is None else starting.enter_context(forks.connect())
        process = fork_server.start(command, None if connection is None else (forked.VARIABLE, connection.fileno()))
        if on_start is not None:
            on_start(process)
        server = RunningServer(url="", pid=process.pid, process=process, token=token)
        reader = threading.Thread(target=_copy_log, args=(process.stderr, server.log, echo), daemon=True)
        reader.start()
        try:
            _wait_ready(server, process, load_timeout, reader)
            starting.close()  # it has read its token
            yield server
        finally:
            started = time.monotonic()
            _stop(process)
            server.stop_seconds = time.monotonic() - started
            reader.join()
            process.stdin.close()
            process.stdout.close()
            process.stderr.close()


@contextlib.contextmanager
def _token_options(token: str | None) -> Iterator[tuple[str, ...]]:
    """Yield the options that pass a token to a server: the token lies in a file that only this user can read."""
    if token is None:
        yield ()
        return
    descriptor, name = tempfile.mkstemp(prefix="xpl-token-")
    try:
        with open(descriptor, "w", encoding="ascii") as file:  # noqa: PTH123 - a descriptor
            file.write(token)
        yield "--token-file", name
    finally:
        Path(name).unlink()


def _wait_ready(server: RunningServer, process: ForkedServer, timeout: float, reader: threading.Thread) -> None:
    """Wait until the server is ready, and store its addresses."""
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        if not selector.select(timeout):
            raise ServerStartError(f"the model was not ready within {timeout:g} s", list(server.log))
    line = process.stdout.readline()
    message = json_text.parse(line) if line else {}
    if "url" not in message:
        process.wait()
        reader.join()
        reason = server.last_error or "it printed nothing"
        frames = parse_frames(message.get(RAISED_AT))
        raise ServerStartError(reason, list(server.log), MissingRequirement.parse(message.get("lacks")), frames)
    server.url, server.also = message["url"], dict(message.get("also", {}))


def _copy_log(stream: IO[bytes], log: collections.deque[str], echo: bool) -> None:  # noqa: FBT001 - private
    while raw := stream.readline(LINE_BYTES):
        text = raw.decode(errors="replace").rstrip("\n")
        log.append(text)
        if echo:
            sys.stderr.write(text + "\n")


def _stop(process: ForkedServer) -> None:
    """Terminate the server, and kill it after a timeout, also if Ctrl-C interrupts the wait."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            pass
        finally:
            spawn.end_group(process.pid)
            process.wait()
