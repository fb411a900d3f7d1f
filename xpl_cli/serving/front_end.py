"""The front end: WebSocket in, workers out. Stays responsive while models load, think or hang."""

from __future__ import annotations

import asyncio
import contextlib
import time
import uuid
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from picows import ws_create_server

from xpl import _spec as spec
from xpl.wire import codec
from xpl_cli.serving.connection import Connection, ConnectionTimeouts
from xpl_cli.serving.entry import connection_limiter
from xpl_cli.serving.entry.admission import BEARER, Admission
from xpl_cli.serving.entry.memory_limiter import MessageMemoryLimiter
from xpl_cli.serving.hello import capabilities, hello_answer, share_memory
from xpl_cli.serving.request_handler import RequestHandler, encode_answer, encode_error, server_fault
from xpl_cli.serving.requests import RequestError
from xpl_cli.serving.server_log import RateLimitedLog, log
from xpl_cli.serving.slots import SlotPool, WorkerSlot
from xpl_cli.serving.workers.worker import ModelWorker

if TYPE_CHECKING:
    import ssl
    from collections.abc import Callable

    from picows import WSUpgradeRequest

    from xpl.contract import Announcement, Payload
    from xpl_cli.serving.connection import ConnectionOwner
    from xpl_cli.serving.entry.allowed_hosts import AllowedHosts
    from xpl_cli.serving.monitoring import Health, RequestMonitor
    from xpl_cli.serving.workers.process import WorkerProcess


_MAX_MALFORMED_PER_MINUTE = 100
"""Frames that cannot be read, of which each is in the log, in a minute."""


@dataclass(frozen=True)
class FrontEndSettings:
    """Where the front end listens, who may come in, and how long it waits; times in seconds.

    Attributes:
        host: address to listen on.
        port: TCP port; 0 lets the system choose.
        timing: deadlines of a connection.
        handshake_timeout: longest time for the opening handshake.
        request_timeout: longest time for one batch.
        grace: how long a place waits for a client whose connection was cut.
        policy: what the policy needs (`xpl.client.agreement`).
        names: what the server goes by, and which pages may speak to it.
        token: bearer token, or None.
        tls: TLS context, or None.
        debug: send tracebacks to clients.
        renew: build the model anew for every client.
    """

    host: str
    port: int
    timing: ConnectionTimeouts
    handshake_timeout: float | None
    request_timeout: float | None
    grace: float
    policy: Announcement
    allowed_hosts: AllowedHosts
    token: str | None = None
    tls: ssl.SSLContext | None = None
    debug: bool = False
    renew: bool = False


@dataclass(frozen=True)
class Endpoint:
    """A port, and what is spoken there.

    Attributes:
        port: TCP port; 0 lets the system choose.
        connection: makes the connection of a peer.
        scheme: how a token is announced there, in lower case.
    """

    port: int
    connection: Callable[[ConnectionOwner, ConnectionTimeouts], Connection]
    scheme: str = BEARER


class FrontEnd:
    """Serves the workers to the clients.

    Args:
        processes: the workers' processes.
        settings: see there.
        observer: is told about every request, or None.

    Attributes:
        state: loading, ready or draining.
        workers: those that are alive.
        failed: resolves with the reason when no worker is left.
    """

    def __init__(
        self, processes: list[WorkerProcess], settings: FrontEndSettings, monitor: RequestMonitor | None = None
    ) -> None:
        self._settings = settings
        self._changed = asyncio.Event()
        self._request_handler = RequestHandler(
            debug=settings.debug, monitor=monitor, on_change=self._changed.set, renew=settings.renew
        )
        self._monitor = monitor
        self._instance = uuid.uuid4().hex
        self._loop = asyncio.get_running_loop()
        # In the order in which they came.
        self._connections: dict[Connection, None] = {}
        self._max_connections, half_open = connection_limiter.connection_limits()
        self._connection_limiter = connection_limiter.ConnectionLimiter(half_open)
        self._malformed_log = RateLimitedLog("refused a frame", max_per_minute=_MAX_MALFORMED_PER_MINUTE)
        self._dropped_log = RateLimitedLog(
            "dropped a connection that had said nothing: there are more than can be served"
        )
        self._memory_limiter = MessageMemoryLimiter()
        self._waiting_hellos: list[tuple[Connection, codec.Frame]] = []
        self._slot_pool = SlotPool(len(processes), 1, settings.grace)
        self._started = time.monotonic()
        self.state: str = spec.ServerState.LOADING
        self.workers = {
            number: ModelWorker(number, process, settings.request_timeout, self._request_handler, self._worker_failed)
            for number, process in enumerate(processes)
        }
        self.failed: asyncio.Future[str] = self._loop.create_future()

    # -- life ----------------------------------------------------------------------------------------------------------

    async def listen(self, entrance: Endpoint | None = None) -> list[asyncio.Server]:
        """Bind the address, or that of another entrance, and start answering; a name may stand for several addresses.

        Raises:
            OSError: if the address cannot be had.
        """
        settings = self._settings
        entrance = entrance or Endpoint(settings.port, Connection)
        metrics = None if self._monitor is None else self._monitor.page
        admission = Admission(
            settings.token, settings.allowed_hosts, self.health, metrics, self._drop_silent, entrance.scheme
        )
        trouble = RateLimitedLog("a connection failed")
        self._loop.set_exception_handler(lambda _, context: trouble.log(_describe_failure(context)))

        def admit(request: WSUpgradeRequest) -> Any:
            return admission.refusal(request) or entrance.connection(self, settings.timing)

        return [
            await ws_create_server(
                admit,
                sock=listening,
                ssl=settings.tls,
                websocket_handshake_timeout=settings.handshake_timeout,
                max_frame_size=spec.LIMITS["frame_bytes"],
            )
            for listening in self._connection_limiter.bind(settings.host, entrance.port)
        ]

    def _drop_silent(self) -> bool:
        """Tell whether one more connection is possible; the oldest that has said nothing makes room."""
        if len(self._connections) < self._max_connections:
            return True
        silent = next((connection for connection in self._connections if connection.is_silent), None)
        if silent is None:
            return False
        self._dropped_log.log()
        del self._connections[silent]
        silent.abort()
        return True

    def ready(self) -> None:
        """Say that the models are loaded, and answer the hellos that waited for that."""
        shared = all(worker.queue.shared for worker in self.workers.values())
        clients = spec.LIMITS["clients"] if shared else 1
        self._slot_pool = SlotPool(len(self.workers), clients, self._settings.grace)
        self.state = spec.ServerState.READY
        waiting, self._waiting_hellos = self._waiting_hellos, []
        for connection, frame in waiting:
            if connection.is_open:
                self._hello(connection, frame)

    def health(self) -> Health:
        """Return the state, and what a person or a supervisor wants to know of it."""
        workers = [
            {
                "process": worker.process.adapter_pid(),
                "busy_s": round(worker.busy_for(), 3),
                "waiting": len(worker.queue),
                "memory_bytes": worker.process.memory(),
            }
            for worker in self.workers.values()
        ]
        return {
            "places": len(self._slot_pool),
            "taken": self._slot_pool.in_use(),
            "connections": len(self._connections),
            "workers": workers,
            **self._state_report(),
        }

    def _state_report(self) -> Health:
        """Return what health, heartbeats and hello tell alike: the state, and how far loading is."""
        progress = {spec.Payload.PROGRESS: self.progress()} if self.state == spec.ServerState.LOADING else {}
        return {spec.Payload.STATE: self.state, **progress}

    def progress(self) -> Health:
        """Return how far loading is: seconds, bytes of memory in use, and what was printed last."""
        processes = [worker.process for worker in self.workers.values()]
        return {
            "seconds": round(time.monotonic() - self._started, 3),
            "memory_bytes": sum(process.memory() for process in processes),
            "message": next((process.last_line for process in processes if process.last_line), ""),
        }

    async def drain(self, seconds: float) -> None:
        """Begin nothing new, and let what runs for a client that is still there end, for some seconds at most."""
        self.state = spec.ServerState.DRAINING
        if self._is_busy():
            log(f"waiting up to {seconds:g} s for the requests that run; interrupt again to end now")
            await self._until(lambda: not self._is_busy(), seconds)

    async def close_connections(self, code: int, reason: str) -> None:
        """Close every connection and tell why."""
        for connection in list(self._connections):
            connection.close(code, reason)
        await self._until(lambda: not self._connections, self._settings.timing.close or 0.0)

    def _is_busy(self) -> bool:
        return any(connection.is_busy for connection in self._connections)

    async def _until(self, condition: Callable[[], bool], seconds: float) -> None:
        """Wait until a condition holds, which only what connections do can bring about."""
        deadline = self._loop.time() + seconds
        while not condition() and (left := deadline - self._loop.time()) > 0.0:
            self._changed.clear()
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._changed.wait(), left)

    # -- what connections tell -----------------------------------------------------------------------------------------

    def connection_opened(self, connection: Connection) -> None:
        """Count a connection."""
        self._connections[connection] = None
        self._connection_limiter.note_upgrade(connection.descriptor)

    def memory_changed(self, connection: Connection) -> None:
        """Count the memory of a connection's messages."""
        self._memory_limiter.update(connection)

    def connection_closed(self, connection: Connection, *, clean: bool) -> None:
        """Take the connection's place back, and the memory that it shared once nothing in the line uses it."""
        self._connections.pop(connection, None)
        self._memory_limiter.forget(connection)
        self._changed.set()
        self._release_slot(connection, clean=clean)
        place, number = connection.slot, connection.segment_number
        worker = None if place is None else self.workers.get(place.worker)
        if place is not None and number is not None and worker is not None:
            # What still waits for the worker may lie there.
            worker.call_when_done(
                place, lambda: worker.send_control({"op": "unmap", "segment": number}, lambda _: None)
            )

    def _release_slot(self, connection: Connection, *, clean: bool) -> None:
        place = self._slot_pool.release(connection, clean=clean)
        if place is not None and place.worker in self.workers:
            self.workers[place.worker].queue.forget(place)

    def handle_message(self, connection: Connection, data: bytes | memoryview) -> None:
        """Answer a message, now or when a worker has."""
        try:
            frame = codec.decode(data)
        except codec.WireError as error:
            self._malformed_log.log(str(error))
            if error.message_id is not None:
                known = {spec.Frame.EVALUATION_ID: "", **error.identifiers}
                refused = RequestError(spec.ErrorCode.INVALID_FRAME, str(error), spec.ErrorReason.UNREADABLE)
                connection.send(encode_error(codec.Frame(spec.Message.ERROR, **known), refused))
            return
        self.handle_request(connection, frame, len(data))

    def handle_request(self, connection: Connection, frame: codec.Frame, size: int) -> None:
        """Answer a request of so many bytes, now or when a worker has."""
        kind = frame.message_type
        if kind == spec.Message.CLOSE:
            self._release_slot(connection, clean=True)
            connection.close(1000)
            return
        connection.expect_answer(size)
        if kind == spec.Message.HEARTBEAT:
            self._heartbeat(connection, frame)
        elif kind == spec.Message.HELLO:
            self._hello(connection, frame)
        else:
            self._request(connection, frame, size)

    # -- answers that need no worker -----------------------------------------------------------------------------------

    def _heartbeat(self, connection: Connection, frame: codec.Frame) -> None:
        connection.answer(encode_answer(frame, {spec.Payload.OK: True, **self._state_report()}))

    def _hello(self, connection: Connection, frame: codec.Frame) -> None:
        """Greet a client, or say why not; one that does not know about loading is greeted once the models are there."""
        try:
            answer = self._greeting(connection, frame)
        except RequestError as error:
            connection.answer(encode_error(frame, error))
        except Exception as error:  # noqa: BLE001 - one bad hello must cost nobody else anything
            connection.answer(encode_error(frame, server_fault(error)))
        else:
            if answer is not None:
                connection.answer(encode_answer(frame, answer))

    def _greeting(self, connection: Connection, frame: codec.Frame) -> Payload | None:
        """Return the answer to hello: while the models load without a place, or None for who waits for them."""
        asked = capabilities(frame)
        answer = hello_answer(self._settings.policy, self.state, frame, guarded=self._settings.token is not None)
        connection.reads_packed = bool(asked.get(spec.Capability.PACKED))
        connection.numbers_requests = bool(asked.get(spec.Capability.SEQUENCE))
        if self.state == spec.ServerState.LOADING:
            if not asked.get(spec.Capability.LOADING):
                self._waiting_hellos.append((connection, frame))
                return None
            return {**answer, spec.Payload.SERVER_INSTANCE_ID: self._instance, **self._state_report()}
        place = self._assign_slot(connection, frame)
        answer[spec.Payload.SERVER_INSTANCE_ID] = f"{self._instance}-{place.tenancy}"
        # Not with TLS: it says that the client is elsewhere, or that what it sends is to be seen by nobody.
        wanted = None if self._settings.tls is not None else asked.get(spec.Capability.SHARED_MEMORY)
        shared = share_memory(connection, self.workers[place.worker], wanted)
        if shared is not None:
            answer[spec.Payload.CAPABILITIES][spec.Capability.SHARED_MEMORY] = shared
        return answer

    def _request(self, connection: Connection, frame: codec.Frame, size: int) -> None:
        """Hand a request to the desk, if there is a place for it."""
        try:
            place = self._slot_for_request(connection, frame)
        except RequestError as error:
            self._request_handler.refuse(connection, None, frame, None, error)
        else:
            self._request_handler.handle(connection, place, self.workers[place.worker], frame, size)

    def _slot_for_request(self, connection: Connection, frame: codec.Frame) -> WorkerSlot:
        """Return the place that a request is about.

        Raises:
            RequestError: if it is no request, or cannot be served now.
        """
        if frame.message_type not in spec.ANSWERS:
            raise _not_a_request(frame.message_type)
        if self.state == spec.ServerState.LOADING:
            raise RequestError(spec.ErrorCode.INTERNAL, "the model is still loading", spec.ErrorReason.LOADING)
        place = self._assign_slot(connection, frame)
        if self.state == spec.ServerState.DRAINING and place.replay.find(frame) is None:
            text = "the policy server is shutting down"
            raise RequestError(spec.ErrorCode.INTERNAL, text, spec.ErrorReason.SHUTTING_DOWN)
        return place

    # -- places and workers --------------------------------------------------------------------------------------------

    def _assign_slot(self, connection: Connection, frame: codec.Frame) -> WorkerSlot:
        place = self._slot_pool.slot_of(connection)
        if place is not None:
            return place
        session = capabilities(frame).get(spec.Capability.SESSION) if frame.message_type == spec.Message.HELLO else None
        place, lost = self._slot_pool.assign(
            connection, frame.evaluation_id, session if isinstance(session, str) else None
        )
        connection.slot = place
        if isinstance(lost, Connection):
            lost.close(spec.CLOSE_CODES["replaced"], "the same client came back over another connection")
        return place

    def _worker_failed(self, worker: ModelWorker, reason: str) -> None:
        """Go on with the others; the clients of this one are told, and no longer served."""
        self.workers.pop(worker.number, None)
        for connection in self._slot_pool.remove_worker(worker.number):
            if isinstance(connection, Connection):
                connection.close(spec.CLOSE_CODES["server_failed"], reason)
        if not self.workers or self.state == spec.ServerState.LOADING:
            if not self.failed.done():
                self.failed.set_result(reason)
            return
        log(f"{reason}; {len(self.workers)} of the workers go on")
        self._loop.create_task(worker.process.stop(grace=1.0))


def _describe_failure(context: dict[str, Any]) -> str:
    error = context.get("exception")
    return str(context.get("message")) + ("" if error is None else f" ({type(error).__name__}: {error})")


def _not_a_request(kind: str) -> RequestError:
    known = kind == spec.Message.ERROR or kind in spec.ANSWERS.values()
    code = spec.ErrorCode.UNKNOWN_MESSAGE_TYPE if known else spec.ErrorCode.INVALID_FRAME
    return RequestError(code, f"message_type {kind!r:.80} is not a request; requests are {', '.join(spec.ANSWERS)}")
