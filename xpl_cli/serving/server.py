"""The front end: WebSocket in, worker out. Stays responsive while the model loads, thinks or hangs."""

from __future__ import annotations

import asyncio
import sys
import time
import uuid
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from xpl import _spec as spec
from xpl import images, wire
from xpl.observation import ObservationError
from xpl_cli import __version__
from xpl_cli.serving.session import Lease, Replay, RequestError, operation
from xpl_cli.serving.worker_process import WorkerDiedError, WorkerError

if TYPE_CHECKING:
    from xpl_cli.serving.worker_process import WorkerProcess

_CLEAN_CODES = (1000, 1001)


@dataclass(frozen=True)
class Settings:
    """Where the front end listens and how long it waits; times in seconds."""

    host: str
    port: int
    request_timeout: float | None
    ping_interval: float | None
    ping_timeout: float | None
    close_timeout: float | None
    debug: bool = False


class FrontEnd:
    """Serves one worker to one client at a time.

    Attributes:
        ready: set when the model is loaded; no hello is answered before.
        failed: resolves with the reason if the worker cannot go on.
    """

    def __init__(self, worker: WorkerProcess, settings: Settings) -> None:
        self._worker = worker
        self._settings = settings
        self._instance = uuid.uuid4().hex
        self._lease = Lease()
        self._replay = Replay()
        self.ready = asyncio.Event()
        self.failed: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    async def listen(self) -> Server:
        """Bind the address and start answering."""
        settings = self._settings
        return await serve(
            self._connection,
            settings.host,
            settings.port,
            compression=None,  # images do not shrink, and deflating them costs more than the rest of the request
            max_size=spec.LIMITS["frame_bytes"],
            ping_interval=settings.ping_interval,
            ping_timeout=settings.ping_timeout,
            close_timeout=settings.close_timeout,
        )

    async def _connection(self, socket: ServerConnection) -> None:
        tasks: set[asyncio.Task[None]] = set()
        try:
            async for data in socket:
                if isinstance(data, str):
                    continue  # the wire is binary only
                frame = await self._understood(socket, data)
                if frame is None:
                    continue
                if frame.message_type == spec.Message.CLOSE:
                    self._lease.release(socket, clean=True)
                    await socket.close()
                    break
                # A task per frame keeps heartbeats answered during inference; the worker keeps requests in order.
                task = asyncio.create_task(self._answer(socket, frame))
                tasks.add(task)
                task.add_done_callback(tasks.discard)
        except ConnectionClosed:
            pass
        finally:
            self._lease.release(socket, clean=socket.close_code in _CLEAN_CODES)

    async def _understood(self, socket: ServerConnection, data: bytes) -> wire.Frame | None:
        try:
            return wire.decode(data)
        except wire.WireError as error:
            _log(f"refused a frame: {error}")
            if error.message_id is not None:
                refusal = RequestError(spec.ErrorCode.INVALID_FRAME, str(error))
                frame = wire.Frame(spec.Message.ERROR, "", refusal.payload(), message_id=error.message_id)
                await socket.send(wire.encode(frame))
            return None

    async def _answer(self, socket: ServerConnection, frame: wire.Frame) -> None:
        try:
            data = await self._answer_once(socket, frame)
        except RequestError as error:
            data = wire.encode(frame.answer(spec.Message.ERROR, error.payload()))
        try:
            await socket.send(data)
        except ConnectionClosed:
            _log(f"the client left before the answer to its {frame.message_type}")

    async def _answer_once(self, socket: ServerConnection, frame: wire.Frame) -> bytes:
        kind = frame.message_type
        if kind not in spec.ANSWERS:
            known = ", ".join(spec.ANSWERS)
            raise RequestError(
                spec.ErrorCode.INVALID_FRAME, f"message_type {kind!r} is not a request; known are {known}"
            )
        if kind == spec.Message.HEARTBEAT:
            return self._encoded(frame, {spec.Payload.OK: True})
        if kind == spec.Message.HELLO:
            await self.ready.wait()
            self._lease.take(socket, frame.evaluation_id)
            return self._encoded(frame, self._greeting())
        self._lease.take(socket, frame.evaluation_id)
        running = self._replay.find(frame)
        if running is None:
            # Not tied to the connection: a cut must not stop what a retry will ask for.
            running = asyncio.ensure_future(self._run(frame))
            self._replay.add(frame, running)
        return await asyncio.shield(running)

    def _greeting(self) -> dict[str, Any]:
        return {
            spec.Payload.OK: True,
            spec.Payload.SERVER: f"xpl {__version__}",
            spec.Payload.SERVER_INSTANCE_ID: self._instance,
            spec.Payload.CAPABILITIES: {"wire_version": spec.WIRE_VERSION, "jpeg_marker": True},
        }

    async def _run(self, frame: wire.Frame) -> bytes:
        try:
            return self._encoded(frame, await self._result(frame))
        except RequestError as error:
            return wire.encode(frame.answer(spec.Message.ERROR, error.payload()))

    async def _result(self, frame: wire.Frame) -> dict[str, Any]:
        await self.ready.wait()
        planned = operation(frame)
        started = time.perf_counter()
        result = await self._ask(await _decoded(planned.request), planned.failure)
        latency = (time.perf_counter() - started) * 1000.0
        if frame.message_type == spec.Message.INFER:
            passed = (
                result
                if isinstance(result, dict) and spec.Payload.ACTIONS in result
                else {spec.Payload.ACTIONS: result}
            )
            return {spec.Payload.LATENCY_MS: latency, **passed}
        answer: dict[str, Any] = {spec.Payload.OK: True}
        if result is not None:
            answer[spec.Payload.RESULT] = result
        if frame.message_type == spec.Message.CALL:
            answer[spec.Payload.LATENCY_MS] = latency
        return answer

    async def _ask(self, request: dict[str, Any], failure: str) -> Any:
        """Have the worker do something; every way to fail becomes an answer, and a fatal one ends the server."""
        timeout = self._settings.request_timeout
        try:
            return await asyncio.wait_for(self._worker.request(**request), timeout)
        except WorkerError as error:
            _log(error.trace.rstrip())
            if error.unserialisable:
                raise RequestError(spec.ErrorCode.INTERNAL, str(error)) from None
            if error.kind == AttributeError.__name__ and "has no method" in str(error):
                if request["method"] in spec.HOOKS:
                    return None  # hooks are optional
                raise RequestError(spec.ErrorCode.INVALID_FRAME, str(error)) from None
            text = error.trace if self._settings.debug else f"{error.kind}: {error}"
            raise RequestError(failure, text) from None
        except WorkerDiedError as error:
            self._fail(str(error))
            raise RequestError(spec.ErrorCode.INTERNAL, str(error), spec.ErrorReason.WORKER_DIED) from None
        except TimeoutError:
            text = f"the model did not answer within {timeout:g} s"
            self._fail(text)
            raise RequestError(spec.ErrorCode.TIMEOUT, text) from None

    def _fail(self, reason: str) -> None:
        if not self.failed.done():
            self.failed.set_result(reason)

    def _encoded(self, frame: wire.Frame, payload: dict[str, Any]) -> bytes:
        answer = spec.ANSWERS[frame.message_type]
        try:
            return wire.encode(frame.answer(str(answer), payload))
        except wire.WireError as error:
            raise RequestError(spec.ErrorCode.INTERNAL, str(error)) from None


async def _decoded(request: dict[str, Any]) -> dict[str, Any]:
    """Return the request with encoded images decoded, off the event loop where there are any."""

    def decode() -> dict[str, Any]:
        if request["op"] == "infer":
            return {**request, "observation": images.decode_observation(request["observation"])}
        args = [
            [images.decode_observation(item) for item in argument]
            if isinstance(argument, list)
            else images.decode_observation(argument)
            for argument in request["args"]
        ]
        return {**request, "args": args}

    try:
        return await asyncio.to_thread(decode) if "observation" in request or request.get("args") else request
    except ObservationError as error:
        raise RequestError(spec.ErrorCode.INVALID_FRAME, str(error)) from None


def _log(text: str) -> None:
    sys.stderr.write(f"[server] {text}\n")
    sys.stderr.flush()
