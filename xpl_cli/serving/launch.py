"""Start a policy server as a process of its own, wait until it is ready, and end it for certain."""

from __future__ import annotations

import collections
import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, Any

from xpl_cli.errors import ExitCode, UserError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

STOP_S = 10.0
LOG_LINES = 400


class ServerStartError(UserError):
    """The server ended, or stayed silent, before it was ready.

    Attributes:
        reason: the sentence.
        log: last lines of its output.
    """

    def __init__(self, reason: str, log: list[str]) -> None:
        super().__init__(reason, code=ExitCode.NOT_RUN)
        self.reason = reason
        self.log = log


@dataclass
class RunningServer:
    """A policy server that answers.

    Attributes:
        url: where it answers.
        pid: process of its front end.
        log: last lines of what it and the adapter printed.
    """

    url: str
    pid: int
    log: collections.deque[str] = field(default_factory=lambda: collections.deque(maxlen=LOG_LINES))


@contextlib.contextmanager
def serving(  # noqa: PLR0913 - what `xpl serve` takes
    policy: Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    python: str | None = None,
    env: str | None = None,
    gpu: str | None = None,
    options: Sequence[str] = (),
    load_timeout: float = 600.0,
    echo: bool = False,
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

    Raises:
        ServerStartError: if it does not become ready.
    """
    command = [sys.executable, "-m", "xpl_cli", "serve", str(policy), "--port", "0", "--host", "localhost"]
    # The server holds our end of its standard input: if this process is killed, the server notices and ends too.
    command.append("--until-stdin-ends")
    for key, value in (overrides or {}).items():
        command += ["--set", f"{key}={json.dumps(value)}"]
    for option, value in (("--python", python), ("--policy-env", env), ("--gpu", gpu)):
        command += [option, value] if value is not None else []
    command += options
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    )
    server = RunningServer(url="", pid=process.pid)
    assert process.stdin is not None  # noqa: S101 - for the type checker: PIPE was asked for
    assert process.stdout is not None  # noqa: S101
    assert process.stderr is not None  # noqa: S101
    reader = threading.Thread(target=_collect, args=(process.stderr, server.log, echo), daemon=True)
    reader.start()
    try:
        server.url = _wait_ready(process, process.stdout, load_timeout, reader, server.log)
        yield server
    finally:
        _stop(process)
        reader.join()
        process.stdin.close()
        process.stdout.close()
        process.stderr.close()


def _wait_ready(
    process: subprocess.Popen[bytes],
    stdout: IO[bytes],
    timeout: float,
    reader: threading.Thread,
    log: collections.deque[str],
) -> str:
    deadline = time.monotonic() + timeout
    with selectors.DefaultSelector() as selector:
        selector.register(stdout, selectors.EVENT_READ)
        if not selector.select(max(0.0, deadline - time.monotonic())):
            raise ServerStartError(f"the model was not ready within {timeout:g} s", list(log))
    line = stdout.readline()
    if not line:
        process.wait()
        reader.join()
        reason = next((text for text in reversed(log) if text.startswith("error: ")), "error: it printed nothing")
        raise ServerStartError(reason.removeprefix("error: "), list(log))
    url: str = json.loads(line)["url"]
    return url


def _collect(stream: IO[bytes], log: collections.deque[str], echo: bool) -> None:  # noqa: FBT001 - private
    for raw in stream:
        text = raw.decode(errors="replace").rstrip("\n")
        log.append(text)
        if echo:
            sys.stderr.write(text + "\n")


def _stop(process: subprocess.Popen[bytes]) -> None:
    """End the server in order, and by force if that takes too long. Ctrl-C during this does not leave it behind."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            pass
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
