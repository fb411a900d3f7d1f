"""Run a policy server until it is told to end: start the worker, load, listen, announce readiness, shut down."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl.link import LinkError
from xpl_cli import interpreter
from xpl_cli.errors import ExitCode, UserError
from xpl_cli.serving.server import FrontEnd, Settings
from xpl_cli.serving.worker_process import WorkerDiedError, WorkerError, WorkerProcess

if TYPE_CHECKING:
    from collections.abc import Mapping

    from websockets.asyncio.server import Server

    from xpl_cli.package import Package

_LOOPBACK = ("localhost", "127.0.0.1", "::1")


def run_server(  # noqa: PLR0913 - one parameter per option of `xpl serve`
    package: Package,
    overrides: Mapping[str, Any],
    *,
    python: str | None = None,
    env: str | None = None,
    gpu: str | None = None,
    insecure: bool = False,
    debug: bool = False,
    until_stdin_ends: bool = False,
) -> None:
    """Serve an adapter until SIGINT or SIGTERM.

    Prints one JSON line `{"event": "ready", "url": ..., ...}` on stdout when the model is loaded.

    Raises:
        UserError: if the model cannot be loaded, the address cannot be bound, or the worker ends.
    """
    config = package.config(overrides)
    host = config[spec.Deploy.HOST] or _LOOPBACK[0]
    if host not in _LOOPBACK and not insecure:
        raise UserError(
            f"host is {host!r}: without authentication the server listens on loopback only",
            hint="add --insecure to let every machine that reaches this address drive the policy",
        )
    interpreter_path = interpreter.resolve(package.path, package.manifest, python=python, env=env)
    settings = Settings(
        host=host,
        port=config[spec.Deploy.PORT] or 0,
        request_timeout=config[spec.Deploy.REQUEST_TIMEOUT_S],
        ping_interval=config[spec.Deploy.WS_PING_INTERVAL_S],
        ping_timeout=config[spec.Deploy.WS_PING_TIMEOUT_S],
        close_timeout=config[spec.Deploy.CLOSE_TIMEOUT_S],
        debug=debug,
    )
    work = _serve(package, config, settings, interpreter_path, gpu, until_stdin_ends=until_stdin_ends)
    reason = asyncio.run(work)
    if reason is not None:
        raise UserError(f"{package.name}: {reason}", code=ExitCode.NOT_RUN)


async def _serve(  # noqa: PLR0913 - see run_server
    package: Package,
    config: dict[str, Any],
    settings: Settings,
    python: str,
    gpu: str | None,
    *,
    until_stdin_ends: bool,
) -> str | None:
    """Serve until a signal; return why it could not go on, or None."""
    stopping = asyncio.get_running_loop().create_future()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, _end, stopping)
    if until_stdin_ends:
        asyncio.get_running_loop().add_reader(sys.stdin.fileno(), _watch_stdin, stopping)
    worker = await WorkerProcess.start(python, cwd=package.path, gpu=gpu)
    try:
        front_end = FrontEnd(worker, settings)
        try:
            server = await front_end.listen()
        except OSError as error:
            return f"cannot listen on {settings.host}:{settings.port}: {error.strerror}"
        loading = asyncio.create_task(_load(worker, package, config))
        async with server:
            await asyncio.wait({loading, stopping}, return_when=asyncio.FIRST_COMPLETED)
            if stopping.done():
                loading.cancel()
                await asyncio.wait({loading})
                return None
            problem = loading.result()
            if problem is not None:
                await front_end.dismiss(problem)
                return problem
            front_end.ready.set()
            host, port = _address(server, settings.host)
            ready = {"event": "ready", "policy": package.name, "url": f"ws://{host}:{port}", "port": port}
            sys.stdout.write(json.dumps(ready) + "\n")
            sys.stdout.flush()
            ended = asyncio.create_task(worker.ended())
            await asyncio.wait({stopping, front_end.failed, ended}, return_when=asyncio.FIRST_COMPLETED)
            if stopping.done():
                return None
            reason = front_end.failed.result() if front_end.failed.done() else ended.result()
            await front_end.dismiss(reason)
            return reason
    finally:
        await worker.stop(grace=1.0)


def _address(server: Server, host: str) -> tuple[str, int]:
    """Return host and port to connect to. `localhost` has two addresses, and a port that was chosen is free on one."""
    bound, port = server.sockets[0].getsockname()[:2]
    if host not in _LOOPBACK:
        return host, port
    return (f"[{bound}]" if ":" in bound else bound), port


def _end(stopping: asyncio.Future[None]) -> None:
    if not stopping.done():
        stopping.set_result(None)


def _watch_stdin(stopping: asyncio.Future[None]) -> None:
    """End when whoever started this server is gone: the last holder of the other end of standard input."""
    if not os.read(sys.stdin.fileno(), 4096):
        _end(stopping)
        asyncio.get_running_loop().remove_reader(sys.stdin.fileno())


async def _load(worker: WorkerProcess, package: Package, config: dict[str, Any]) -> str | None:
    """Load the adapter; return why it failed, or None."""
    try:
        await worker.request(op="load", policy_dir=str(package.path), config=config, manifest=dict(package.manifest))
    except WorkerError as error:
        sys.stderr.write(error.trace)
        return f"the model could not be loaded: {error.kind}: {error}"
    except (WorkerDiedError, LinkError) as error:
        return f"the model could not be loaded: {error}"
    return None
