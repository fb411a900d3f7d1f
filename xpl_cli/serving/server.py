"""The front end: WebSocket in, workers out. Stays responsive while models load, think or hang."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import time
import traceback
import uuid
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from picows import ws_create_server

from xpl import _spec as spec
from xpl import agreement, packed, wire
from xpl.segment import Segment, SegmentError
from xpl_cli import __version__
from xpl_cli.serving.admission import Admission
from xpl_cli.serving.connection import Connection, Timing
from xpl_cli.serving.line import Job
from xpl_cli.serving.payloads import answer_payload, has_images, pack, without_images
from xpl_cli.serving.places import Place, Places
from xpl_cli.serving.pool import Worker, log
from xpl_cli.serving.session import RequestError, Task, packed_payload, task

if TYPE_CHECKING:
    import ssl
    from collections.abc import Callable

    from picows import WSUpgradeRequest

    from xpl_cli.serving.observe import Observer
    from xpl_cli.serving.session import Entry
    from xpl_cli.serving.worker_process import WorkerProcess

_BEFORE_AN_EPISODE = frozenset((spec.Method.RESET, *spec.HOOKS))


@dataclass(frozen=True)
class Settings:
    """Where the front end listens, who may come in, and how long it waits; times in seconds.

    Attributes:
        host: address to listen on.
        port: TCP port; 0 lets the system choose.
        timing: deadlines of a connection.
        handshake_timeout: longest time for the opening handshake.
        request_timeout: longest time for one batch.
        grace: how long a place waits for a client whose connection was cut.
        policy: what the policy needs (`xpl.agreement`).
        token: bearer token, or None.
        tls: TLS context, or None.
        debug: send tracebacks to clients.
    """

    host: str
    port: int
    timing: Timing
    handshake_timeout: float | None
    request_timeout: float | None
    grace: float
    policy: dict[str, Any]
    token: str | None = None
    tls: ssl.SSLContext | None = None
    debug: bool = False


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

    def __init__(self, processes: list[WorkerProcess], settings: Settings, observer: Observer | None = None) -> None:
        self._settings = settings
        self._observer = observer
        self._instance = uuid.uuid4().hex
        self._loop = asyncio.get_running_loop()
        self._connections: set[Connection] = set()
        self._waiting: list[tuple[Connection, wire.Frame]] = []
        self._places = Places(len(processes), 1, settings.grace)
        self._segments = itertools.count(1)
        self._changed = asyncio.Event()
        self._started = time.monotonic()
        self.state: str = spec.ServerState.LOADING
        self.workers = {
            number: Worker(number, process, settings.request_timeout, self._worker_failed)
            for number, process in enumerate(processes)
        }
        self.failed: asyncio.Future[str] = self._loop.create_future()

    # -- life ----------------------------------------------------------------------------------------------------------

    async def listen(self) -> asyncio.Server:
        """Bind the address and start answering."""
        settings = self._settings
        metrics = None if self._observer is None else self._observer.page
        admission = Admission(settings.token, self.health, metrics, lambda: len(self._connections))

        def admit(request: WSUpgradeRequest) -> Any:
            return admission.refusal(request) or Connection(self, settings.timing)

        return await ws_create_server(
            admit,
            settings.host,
            settings.port,
            ssl=settings.tls,
            websocket_handshake_timeout=settings.handshake_timeout,
            max_frame_size=spec.LIMITS["frame_bytes"],
        )

    def ready(self) -> None:
        """Say that the models are loaded, and answer the hellos that waited for that."""
        shared = all(worker.line.shared for worker in self.workers.values())
        clients = spec.LIMITS["clients"] if shared else 1
        self._places = Places(len(self.workers), clients, self._settings.grace)
        self.state = spec.ServerState.READY
        waiting, self._waiting = self._waiting, []
        for connection, frame in waiting:
            if connection.is_open:
                connection.answer(self._guarded(connection, frame, self._hello))

    def health(self) -> dict[str, Any]:
        """Return the state, and what a person or a supervisor wants to know of it."""
        workers = [
            {
                "process": worker.process.pid,
                "busy_s": round(worker.busy_for(), 3),
                "waiting": len(worker.line),
                "memory_bytes": worker.process.memory(),
            }
            for worker in self.workers.values()
        ]
        answer = {
            spec.Payload.STATE: self.state,
            "places": len(self._places),
            "taken": self._places.taken(),
            "connections": len(self._connections),
            "workers": workers,
        }
        return answer | ({spec.Payload.PROGRESS: self.progress()} if self.state == spec.ServerState.LOADING else {})

    def progress(self) -> dict[str, Any]:
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

    async def dismiss(self, code: int, reason: str) -> None:
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

    def connected(self, connection: Connection) -> None:
        """Count a connection."""
        self._connections.add(connection)

    def disconnected(self, connection: Connection, *, clean: bool) -> None:
        """Take the connection's place back, and the memory that it shared once nothing in the line uses it."""
        self._connections.discard(connection)
        self._changed.set()
        place = self._places.leave(connection, clean=clean)
        if place is None or place.worker not in self.workers:
            return
        worker = self.workers[place.worker]
        worker.line.forget(place)
        if connection.segment_number is not None:
            number = connection.segment_number
            worker.after(place, lambda: worker.errand({"op": "unmap", "segment": number}, lambda _: None))

    def received(self, connection: Connection, data: bytes | memoryview) -> None:
        """Answer a message, now or when a worker has."""
        try:
            frame = wire.decode(data)
        except wire.WireError as error:
            log(f"refused a frame: {error}")
            if error.message_id is not None:
                known = {spec.Frame.EVALUATION_ID: "", **error.identifiers}
                refusal = RequestError(spec.ErrorCode.INVALID_FRAME, str(error)).payload()
                connection.send(wire.encode(wire.Frame(spec.Message.ERROR, payload=refusal, **known)))
            return
        kind = frame.message_type
        if kind == spec.Message.CLOSE:
            self._places.leave(connection, clean=True)
            connection.close(1000)
            return
        connection.expect_answer()
        if kind == spec.Message.HEARTBEAT:
            connection.answer(self._guarded(connection, frame, self._heartbeat))
        elif kind == spec.Message.HELLO:
            if self.state == spec.ServerState.LOADING and not _capabilities(frame).get(spec.Capability.LOADING):
                self._waiting.append((connection, frame))
            else:
                connection.answer(self._guarded(connection, frame, self._hello))
        else:
            self._request(connection, frame, len(data))

    # -- answers that need no worker -----------------------------------------------------------------------------------

    def _guarded(
        self, connection: Connection, frame: wire.Frame, answer: Callable[[Connection, wire.Frame], dict[str, Any]]
    ) -> bytes:
        try:
            return wire.encode(frame.answer(str(spec.ANSWERS[frame.message_type]), answer(connection, frame)))
        except RequestError as error:
            return refusal(frame, error)
        except Exception as error:  # noqa: BLE001 - a fault of ours must not leave the client waiting
            return refusal(frame, _fault(error))

    def _heartbeat(self, _connection: Connection, _frame: wire.Frame) -> dict[str, Any]:
        answer = {spec.Payload.OK: True, spec.Payload.STATE: self.state}
        return answer | ({spec.Payload.PROGRESS: self.progress()} if self.state == spec.ServerState.LOADING else {})

    def _hello(self, connection: Connection, frame: wire.Frame) -> dict[str, Any]:
        asked = _capabilities(frame)
        offered = frame.payload.get(spec.Payload.ENVIRONMENT)
        found = agreement.differences(self._settings.policy, offered) if isinstance(offered, dict) else []
        if found:
            raise RequestError(
                spec.ErrorCode.INVALID_FRAME, agreement.sentence(found), spec.ErrorReason.MISMATCH, differences=found
            )
        answer: dict[str, Any] = {
            spec.Payload.OK: True,
            spec.Payload.SERVER: f"xpl {__version__}",
            spec.Payload.STATE: self.state,
            spec.Payload.POLICY: self._settings.policy,
            spec.Payload.CAPABILITIES: {
                spec.Capability.WIRE_VERSION: spec.WIRE_VERSION,
                spec.Capability.JPEG_MARKER: True,
                spec.Capability.LOADING: True,
                spec.Capability.PACKED: 1,
                spec.Capability.PIPELINING: True,
            },
        }
        if self.state == spec.ServerState.LOADING:
            answer[spec.Payload.SERVER_INSTANCE_ID] = self._instance
            return answer | {spec.Payload.PROGRESS: self.progress()}
        place = self._place(connection, frame)
        answer[spec.Payload.SERVER_INSTANCE_ID] = f"{self._instance}-{place.tenancy}"
        shared = self._share(connection, place, asked.get(spec.Capability.SHARED_MEMORY))
        if shared is not None:
            answer[spec.Payload.CAPABILITIES][spec.Capability.SHARED_MEMORY] = shared
        return answer

    def _share(self, connection: Connection, place: Place, asked: Any) -> dict[str, Any] | None:
        """Offer shared memory to a client on this host, or check its proof that it sees what was offered."""
        if not asked or not connection.is_local or self._settings.tls is not None:
            return None
        if connection.segment is None:
            try:
                connection.segment = Segment()
            except SegmentError as error:
                log(str(error))
                return None
            return {"path": str(connection.segment.path), "size": connection.segment.size}
        segment, proof = connection.segment, asked.get("proof") if isinstance(asked, dict) else None
        if connection.segment_number is not None or proof != segment.token.hex():
            return None
        answer = segment.answer().hex()
        connection.segment_number = next(self._segments)
        # Unlinked by the answer to this: whoever dies from now on, the system clears up.
        self.workers[place.worker].errand(
            {"op": "map", "segment": connection.segment_number, "path": str(segment.path), "size": segment.size},
            lambda _: segment.unlink(),
        )
        return {"proof": answer}

    # -- answers that a worker gives -----------------------------------------------------------------------------------

    def _request(self, connection: Connection, frame: wire.Frame, size: int) -> None:
        """Decide at once what becomes of a request, so that requests run in the order in which they came."""
        entry: Entry | None = None
        try:
            place = self._place_for(connection, frame)
            entry = place.replay.find(frame)
            if entry is None:
                self._check_running()
                planned = task(frame)
                entry = place.replay.begin(frame)
                entry.waiting.append(connection.answer)
                answerer = self._answerer(entry)
                self._start(Job(planned, place, connection.segment_number, answerer, size, time.monotonic()))
            elif entry.answer is None:
                entry.waiting.append(connection.answer)
            else:
                connection.answer(entry.answer)
        except RequestError as error:
            self._refuse(connection, frame, entry, error)
        except Exception as error:  # noqa: BLE001 - a fault of ours must not leave the client waiting
            self._refuse(connection, frame, entry, _fault(error))

    def _place_for(self, connection: Connection, frame: wire.Frame) -> Place:
        """Return the place that a request of a connection is about.

        Raises:
            RequestError: if it is no request, or there is none.
        """
        if frame.message_type not in spec.ANSWERS:
            raise _not_a_request(frame.message_type)
        if self.state == spec.ServerState.LOADING:
            raise RequestError(spec.ErrorCode.INTERNAL, "the model is still loading", spec.ErrorReason.LOADING)
        return self._place(connection, frame)

    def _check_running(self) -> None:
        """Refuse what is new while the server drains."""
        if self.state == spec.ServerState.DRAINING:
            text = "the policy server is shutting down"
            raise RequestError(spec.ErrorCode.INTERNAL, text, spec.ErrorReason.SHUTTING_DOWN)

    def _start(self, job: Job) -> None:
        """Put a request into its worker's line.

        Raises:
            RequestError: if it cannot be run.
        """
        planned, place = job.task, job.place
        frame, worker = planned.frame, self.workers[place.worker]
        _check_sequence(place, frame)
        if planned.method not in _BEFORE_AN_EPISODE and not place.begun and frame.step > 0:
            raise RequestError(
                planned.failure,
                f"{planned.method} at step {frame.step}, but this server has seen no reset of this client: the "
                "episode's state is elsewhere; reset and begin anew",
                spec.ErrorReason.NO_EPISODE,
            )
        planned.payload = packed_payload(frame)
        if place.stale and planned.method != spec.Method.RESET:
            worker.submit(_internal_reset(place))
        place.stale = False
        place.begun = place.begun or planned.method not in spec.HOOKS
        if planned.payload is None and has_images(frame.payload):
            worker.submit(job)  # holds its place in the line while the images are decoded
            decoding = self._loop.run_in_executor(None, without_images, frame.payload)
            decoding.add_done_callback(lambda done: self._decoded(worker, job, done))
            return
        if planned.payload is None:
            planned.payload = pack(frame.payload)
        worker.submit(job)

    def _decoded(self, worker: Worker, job: Job, done: asyncio.Future[dict[str, Any]]) -> None:
        """Go on with a request whose images were decoded; one whose images are damaged is refused in its turn."""
        try:
            job.task.payload = pack(done.result())
        except RequestError as error:
            worker.line.remove(job)
            job.done(job, error)
        except Exception as error:  # noqa: BLE001 - a fault of ours must not leave the client waiting
            worker.line.remove(job)
            job.done(job, _fault(error))
        worker.pump()

    def _answerer(self, entry: Entry) -> Callable[[Job, dict[str, Any] | RequestError], None]:
        """Return what makes an answer of a worker's into one of the wire, remembers it and sends it."""

        def done(job: Job, answer: dict[str, Any] | RequestError) -> None:
            frame, finished = job.task.frame, time.monotonic()
            outcome = "ok"
            try:
                data = self._encoded(frame, self._result(job.task, answer), 1000.0 * (finished - job.arrived))
            except RequestError as error:
                data, outcome = refusal(frame, error), error.code
            except Exception as error:  # noqa: BLE001 - a fault of ours must not leave the client waiting
                data, outcome = refusal(frame, _fault(error)), spec.ErrorCode.INTERNAL
            job.place.replay.finish(frame.message_id, entry, data)
            self._changed.set()
            if self._observer is not None:
                self._observer.answered(job, finished, len(data), outcome)

        return done

    def _encoded(self, frame: wire.Frame, result: packed.Packed, latency_ms: float) -> bytes:
        kind = str(spec.ANSWERS[frame.message_type])
        payload: dict[str, Any] = {} if frame.message_type == spec.Message.INFER else {spec.Payload.OK: True}
        if frame.message_type in (spec.Message.INFER, spec.Message.CALL):
            payload[spec.Payload.LATENCY_MS] = latency_ms
        try:
            if spec.Payload.PACKED in frame.payload:
                return wire.encode(frame.answer(kind, payload), [result.data])
            return wire.encode(frame.answer(kind, {**payload, **answer_payload(result)}))
        except wire.WireError as error:
            raise RequestError(spec.ErrorCode.INTERNAL, str(error)) from None

    def _result(self, planned: Task, answer: dict[str, Any] | RequestError) -> packed.Packed:
        """Return what the worker answered.

        Raises:
            RequestError: if the adapter raised, or there is no worker any more.
        """
        if isinstance(answer, RequestError):
            raise answer
        if "error" not in answer:
            result: packed.Packed = answer["ok"]
            return result
        raised = answer["error"]
        text = raised["message"]
        if raised.get("unserialisable"):
            log(text)
            raise RequestError(spec.ErrorCode.INTERNAL, f"the result cannot be sent: {text}")
        if raised.get("refused"):
            raise RequestError(spec.ErrorCode.INVALID_FRAME, text)
        log(raised["traceback"].rstrip())
        shown = raised["traceback"] if self._settings.debug else f"{raised['type']}: {text}"
        raise RequestError(planned.failure, shown)

    def _refuse(self, connection: Connection, frame: wire.Frame, entry: Entry | None, error: RequestError) -> None:
        data = refusal(frame, error)
        if self._observer is not None:
            self._observer.refused(frame, error.code)
        place = self._places.of(connection)
        if entry is not None and place is not None:
            place.replay.finish(frame.message_id, entry, data)
        else:
            connection.answer(data)

    # -- places and workers --------------------------------------------------------------------------------------------

    def _place(self, connection: Connection, frame: wire.Frame) -> Place:
        place = self._places.of(connection)
        if place is not None:
            return place
        session = (
            _capabilities(frame).get(spec.Capability.SESSION) if frame.message_type == spec.Message.HELLO else None
        )
        place, lost = self._places.take(connection, frame.evaluation_id, session if isinstance(session, str) else None)
        if isinstance(lost, Connection):
            lost.close(spec.CLOSE_CODES["replaced"], "the same client came back over another connection")
        return place

    def _worker_failed(self, worker: Worker, reason: str) -> None:
        """Go on with the others; the clients of this one are told, and no longer served."""
        self.workers.pop(worker.number, None)
        if not self.workers or self.state == spec.ServerState.LOADING:
            if not self.failed.done():
                self.failed.set_result(reason)
            return
        log(f"{reason}; {len(self.workers)} of the workers go on")
        for connection in self._places.close(worker.number):
            if isinstance(connection, Connection):
                connection.close(spec.CLOSE_CODES["server_failed"], reason)
        self._loop.create_task(worker.process.stop(grace=1.0))


def refusal(frame: wire.Frame, error: RequestError) -> bytes:
    """Return the error frame that answers a request."""
    return wire.encode(frame.answer(spec.Message.ERROR, error.payload()))


def _capabilities(frame: wire.Frame) -> dict[str, Any]:
    given = frame.payload.get(spec.Payload.CAPABILITIES)
    return given if isinstance(given, dict) else {}


def _check_sequence(place: Place, frame: wire.Frame) -> None:
    """Check that no pipelined update is missing: a server that runs frames in another order would be found out."""
    number = frame.payload.get(spec.Payload.SEQUENCE)
    if number is None:
        return
    if number != place.sequence:
        raise RequestError(
            spec.ErrorCode.CALL_FAILED,
            f"expected pipelined update {place.sequence}, got {number!r:.40}",
            spec.ErrorReason.OUT_OF_ORDER,
        )
    place.sequence += 1


def _internal_reset(place: Place) -> Job:
    """Return a job that ends the episode of the client that had the place before."""
    frame = wire.Frame(spec.Message.RESET, "")
    planned = Task(frame, spec.Method.RESET, pack({}))
    return Job(planned, place, None, lambda _, answer: _report_reset(answer))


def _report_reset(answer: dict[str, Any] | RequestError) -> None:
    if isinstance(answer, dict) and "error" in answer:
        log(f"reset for a new client failed: {answer['error']['message']}")


def _fault(error: Exception) -> RequestError:
    log("".join(traceback.format_exception(error)).rstrip())
    return RequestError(spec.ErrorCode.INTERNAL, f"fault of the server: {type(error).__name__}: {error}")


def _not_a_request(kind: str) -> RequestError:
    known = kind == spec.Message.ERROR or kind in spec.ANSWERS.values()
    code = spec.ErrorCode.UNKNOWN_MESSAGE_TYPE if known else spec.ErrorCode.INVALID_FRAME
    return RequestError(code, f"message_type {kind!r:.80} is not a request; requests are {', '.join(spec.ANSWERS)}")
