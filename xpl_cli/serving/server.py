"""The front end: WebSocket in, worker out. Stays responsive while the model loads, thinks or hangs."""

from __future__ import annotations

import asyncio
import socket
import sys
import time
import traceback
import uuid
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from xpl import _spec as spec
from xpl import images, link, wire
from xpl.observation import ObservationError
from xpl.worker import UnknownMethodError
from xpl_cli import __version__
from xpl_cli.serving.session import Lease, Replay, RequestError, operation
from xpl_cli.serving.worker_process import WorkerDiedError, WorkerError

if TYPE_CHECKING:
    from xpl_cli.serving.worker_process import WorkerProcess

_CLEAN_CODES = (1000, 1001)
_CLOSE_REASON_BYTES = 123  # RFC 6455, section 5.5
_DRAIN_S = 2.0


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
        self._turn = asyncio.Lock()
        self._answers: dict[ServerConnection, set[asyncio.Task[None]]] = {}
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
            ping_timeout=None,  # see `_notice_dead_peer`
            close_timeout=settings.close_timeout,
        )

    async def dismiss(self, reason: str) -> None:
        """Let the answers under way reach their clients, then close every connection and tell why."""
        answers = [task for tasks in self._answers.values() for task in tasks]
        if answers and self.ready.is_set():  # otherwise all of them wait for a model that will not come
            await asyncio.wait(answers, timeout=_DRAIN_S)
        short = reason.encode()[:_CLOSE_REASON_BYTES].decode(errors="ignore")
        await asyncio.gather(
            *(connection.close(spec.CLOSE_CODES["server_failed"], short) for connection in self._answers)
        )

    async def _connection(self, connection: ServerConnection) -> None:
        self._notice_dead_peer(connection)
        answers = self._answers[connection] = set()
        try:
            async for data in connection:
                if isinstance(data, str):
                    _log("ignored a text message: the wire is binary")
                    continue
                frame = await self._understood(connection, data)
                if frame is None:
                    continue
                if frame.message_type == spec.Message.CLOSE:
                    self._lease.release(connection, clean=True)
                    await connection.close()
                    break
                # Begun here, so that requests run in the order in which they came; answered by a task, so that
                # heartbeats are answered during inference.
                task = asyncio.create_task(self._answer(connection, frame, self._begin(connection, frame)))
                answers.add(task)
                task.add_done_callback(answers.discard)
        except ConnectionClosed:
            pass
        finally:
            for task in answers:  # nobody is left to be answered
                task.cancel()
            del self._answers[connection]
            self._lease.release(connection, clean=connection.close_code in _CLEAN_CODES)

    def _notice_dead_peer(self, connection: ServerConnection) -> None:
        """Have the kernel cut the connection if the peer's machine no longer acknowledges what is sent, pings included.

        Not by a missing pong: clients in the field answer pings only while a call is under way.
        """
        interval, timeout = self._settings.ping_interval, self._settings.ping_timeout
        if interval and timeout and hasattr(socket, "TCP_USER_TIMEOUT"):
            raw = connection.transport.get_extra_info("socket")
            raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(1000 * (interval + timeout)))

    async def _understood(self, connection: ServerConnection, data: bytes) -> wire.Frame | None:
        try:
            return wire.decode(data)
        except wire.WireError as error:
            _log(f"refused a frame: {error}")
            if error.message_id is not None:
                refusal = RequestError(spec.ErrorCode.INVALID_FRAME, str(error)).payload()
                known = {spec.Frame.EVALUATION_ID: "", **error.identifiers}
                await connection.send(wire.encode(wire.Frame(spec.Message.ERROR, payload=refusal, **known)))
            return None

    async def _answer(self, connection: ServerConnection, frame: wire.Frame, pending: asyncio.Future[bytes]) -> None:
        try:
            await connection.send(await pending)
        except ConnectionClosed:
            _log(f"the client left before the answer to its {frame.message_type}")

    def _begin(self, connection: ServerConnection, frame: wire.Frame) -> asyncio.Future[bytes]:
        """Decide at once what becomes of a request, and return its future answer."""
        try:
            kind = frame.message_type
            if kind not in spec.ANSWERS:
                raise _not_a_request(kind)
            if kind == spec.Message.HEARTBEAT:
                return _done(self._encoded(frame, {spec.Payload.OK: True}))
            if kind == spec.Message.HELLO:
                return asyncio.ensure_future(self._hello(connection, frame))
            self._take_lease(connection, frame)
            running = self._replay.find(frame)
            if running is None:
                running = asyncio.ensure_future(self._run(frame))
                self._replay.add(frame, running)
        except RequestError as error:
            return _done(_refusal(frame, error))
        # Not tied to the connection: a cut must not stop what a retry will ask for.
        return asyncio.shield(running)

    async def _hello(self, connection: ServerConnection, frame: wire.Frame) -> bytes:
        await self.ready.wait()
        if connection not in self._answers:
            return b""  # it left while the model was loading, and would never give the lease back
        try:
            self._take_lease(connection, frame)
            return self._encoded(frame, self._greeting())
        except RequestError as error:
            return _refusal(frame, error)

    def _take_lease(self, connection: ServerConnection, frame: wire.Frame) -> None:
        if self._lease.take(connection, frame.evaluation_id):
            self._replay.forget()

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
            return _refusal(frame, error)
        except Exception as error:  # noqa: BLE001 - a fault of ours must not leave the client waiting
            _log(traceback.format_exc().rstrip())
            text = f"fault of the server: {type(error).__name__}: {error}"
            return _refusal(frame, RequestError(spec.ErrorCode.INTERNAL, text))

    async def _result(self, frame: wire.Frame) -> dict[str, Any]:
        await self.ready.wait()
        planned = operation(frame)
        started = time.perf_counter()
        async with self._turn:  # around the decoding, too: a request without images must not overtake one with them
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
        except link.LinkError as error:
            raise RequestError(spec.ErrorCode.INVALID_FRAME, str(error)) from None
        except WorkerError as error:
            if error.unserialisable:
                _log(str(error))
                raise RequestError(spec.ErrorCode.INTERNAL, f"the result cannot be sent: {error}") from None
            if error.kind == UnknownMethodError.__name__:
                if request["method"] in spec.HOOKS:
                    return None  # hooks are optional
                raise RequestError(spec.ErrorCode.INVALID_FRAME, str(error)) from None
            _log(error.trace.rstrip())
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


def _done(data: bytes) -> asyncio.Future[bytes]:
    future: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
    future.set_result(data)
    return future


def _refusal(frame: wire.Frame, error: RequestError) -> bytes:
    return wire.encode(frame.answer(spec.Message.ERROR, error.payload()))


def _not_a_request(kind: str) -> RequestError:
    known = kind == spec.Message.ERROR or kind in spec.ANSWERS.values()
    code = spec.ErrorCode.UNKNOWN_MESSAGE_TYPE if known else spec.ErrorCode.INVALID_FRAME
    return RequestError(code, f"message_type {kind!r} is not a request; requests are {', '.join(spec.ANSWERS)}")


def _log(text: str) -> None:
    sys.stderr.write(f"[server] {text}\n")
    sys.stderr.flush()
