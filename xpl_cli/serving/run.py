"""Run a policy server until it is told to end: start the worker, load, listen, announce readiness, shut down."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl_cli import interpreter
from xpl_cli.errors import ExitCode, UserError
from xpl_cli.serving.server import FrontEnd, Settings
from xpl_cli.serving.worker_process import WorkerDiedError, WorkerError, WorkerProcess

if TYPE_CHECKING:
    from collections.abc import Mapping

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
    reason = asyncio.run(_serve(package, config, settings, interpreter_path, gpu))
    if reason is not None:
        raise UserError(f"{package.name}: {reason}", code=ExitCode.NOT_RUN)


async def _serve(
    package: Package, config: dict[str, Any], settings: Settings, python: str, gpu: str | None
) -> str | None:
    """Serve until a signal; return why it could not go on, or None."""
    stopping = asyncio.get_running_loop().create_future()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, _end, stopping)
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
                return None
            problem = loading.result()
            if problem is not None:
                return problem
            front_end.ready.set()
            port = server.sockets[0].getsockname()[1]
            ready = {"event": "ready", "policy": package.name, "url": f"ws://{settings.host}:{port}", "port": port}
            sys.stdout.write(json.dumps(ready) + "\n")
            sys.stdout.flush()
            await asyncio.wait({stopping, front_end.failed}, return_when=asyncio.FIRST_COMPLETED)
            return front_end.failed.result() if front_end.failed.done() else None
    finally:
        await worker.stop(grace=1.0)


def _end(stopping: asyncio.Future[None]) -> None:
    if not stopping.done():
        stopping.set_result(None)


async def _load(worker: WorkerProcess, package: Package, config: dict[str, Any]) -> str | None:
    """Load the adapter; return why it failed, or None."""
    try:
        await worker.request(op="load", policy_dir=str(package.path), config=config, manifest=dict(package.manifest))
    except WorkerError as error:
        sys.stderr.write(error.trace)
        return f"the model could not be loaded: {error.kind}: {error}"
    except WorkerDiedError as error:
        return f"the model could not be loaded: {error}"
    return None
