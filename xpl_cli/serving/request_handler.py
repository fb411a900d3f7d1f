"""What becomes of a request: it joins a worker's line, gets the answer that was given before, or is refused."""

from __future__ import annotations

import asyncio
import contextlib
import time
from typing import TYPE_CHECKING

from xpl import _spec as spec
from xpl.wire import codec, packed, telling
from xpl_cli.serving.decoding import ImageDecoder
from xpl_cli.serving.payloads import has_images, pack
from xpl_cli.serving.requests import RequestError, failure_code, method_of, packed_payload
from xpl_cli.serving.server_log import RateLimitedLog, log, log_lines
from xpl_cli.serving.workers.job_queue import RequestJob

if TYPE_CHECKING:
    from collections.abc import Callable

    from xpl.contract import Payload
    from xpl_cli.serving.connection import Connection
    from xpl_cli.serving.monitoring import RequestMonitor
    from xpl_cli.serving.requests import ReplayEntry
    from xpl_cli.serving.slots import WorkerSlot
    from xpl_cli.serving.workers.worker import ModelWorker
    from xpl_cli.serving.workers.worker_answers import AdapterException

_BEFORE_AN_EPISODE = frozenset((spec.Method.RESET, *spec.HOOKS))
_TIMED = frozenset((spec.Message.INFER, spec.Message.CALL))
_NOTHING = pack({})
_ERRORS = 100
"""Exceptions of the adapter, of which each is in the log, in a minute: a client can have it raise again and again."""
_AT_ONCE = 1 << 15
"""Bytes of an answer that is unpacked at once, for a client that does not unpack itself; a thread does larger ones."""


class RequestHandler:
    """Takes requests in and gives answers out.

    Args:
        debug: show tracebacks to clients.
        observer: told about every request, or None.
        on_change: told whenever an answer was given.
        renew: build the model anew for every client, not only reset it.
    """

    def __init__(
        self, *, debug: bool, observer: RequestMonitor | None, on_change: Callable[[], None], renew: bool = False
    ) -> None:
        self._debug = debug
        self._renew = renew
        self._observer = observer
        self._on_change = on_change
        self._decoder = ImageDecoder()
        self._errors = RateLimitedLog("the adapter raised", most=_ERRORS)

    # -- in ------------------------------------------------------------------------------------------------------------

    def take(
        self, connection: Connection, place: WorkerSlot, worker: ModelWorker, frame: codec.Frame, size: int
    ) -> None:
        """Decide at once what becomes of a request, so that requests run in the order in which they came.

        Args:
            connection: who asks.
            place: where it sits.
            worker: who serves that place.
            frame: the request.
            size: its bytes.
        """
        entry: ReplayEntry | None = None
        try:
            entry = place.replay.find(frame)
            if entry is None:
                if connection.counts:
                    _count(place, frame)
                entry = place.replay.begin(frame)
                entry.waiting.append(connection.answer)
                self._begin(
                    worker,
                    RequestJob(
                        frame,
                        method_of(frame),
                        place,
                        payload=packed_payload(frame),
                        segment=connection.segment_number,
                        entry=entry,
                        packs=connection.packs,
                        size=size,
                        received=time.monotonic(),
                    ),
                )
            elif entry.answer is None:
                entry.waiting.append(connection.answer)
            else:
                connection.answer(entry.answer)
        except RequestError as error:
            self.refuse(connection, place, frame, entry, error)
        except Exception as error:  # noqa: BLE001 - a fault of ours must not leave the client waiting
            self.refuse(connection, place, frame, entry, fault(error))

    def refuse(
        self,
        connection: Connection,
        place: WorkerSlot | None,
        frame: codec.Frame,
        entry: ReplayEntry | None,
        error: RequestError,
    ) -> None:
        """Answer a request that no worker was asked."""
        data = refusal(frame, error)
        if self._observer is not None:
            self._observer.refused(frame, error.code)
        if entry is not None and entry.answer is None and place is not None:
            place.replay.finish(frame.message_id, entry, data)
        else:
            connection.answer(data)

    def _begin(self, worker: ModelWorker, job: RequestJob) -> None:
        place, frame = job.place, job.frame
        if job.method not in _BEFORE_AN_EPISODE and not place.begun and frame.step > 0:
            raise RequestError(
                failure_code(frame),
                f"{job.method} at step {frame.step}, but this server has seen no reset of this client: the episode's "
                "state is elsewhere; reset and begin anew",
                spec.ErrorReason.NO_EPISODE,
            )
        if place.stale and self._renew:
            worker.renew()
        elif place.stale and job.method != spec.Method.RESET:
            # The client that had this place before left its episode there.
            worker.submit(RequestJob(codec.Frame(spec.Message.RESET, ""), spec.Method.RESET, place, payload=_NOTHING))
        place.stale = False
        place.begun = place.begun or job.method not in spec.HOOKS
        if job.payload is None and has_images(frame.payload):
            worker.submit(job)  # holds its place in the line while the images are decoded
            self._decoder.decode(job, lambda done: self._decoded(worker, job, done))
            return
        if job.payload is None:
            job.takes(pack(frame.payload))
        worker.submit(job)

    def _decoded(self, worker: ModelWorker, job: RequestJob, done: asyncio.Future[Payload]) -> None:
        """Go on with a request whose images were decoded, or refuse one whose images are damaged."""
        try:
            job.takes(pack(done.result()))
        except RequestError as error:
            worker.line.remove(job)
            self.refused(job, error)
        except Exception as error:  # noqa: BLE001 - a fault of ours must not leave the client waiting
            worker.line.remove(job)
            self.refused(job, fault(error))
        worker.pump()

    # -- out: what a worker tells --------------------------------------------------------------------------------------

    def answered(self, job: RequestJob, result: memoryview) -> None:
        """Send what the worker answered."""
        finished = time.monotonic()
        if len(result) > _AT_ONCE and not _passes(job, result):
            making = asyncio.get_running_loop().run_in_executor(None, _encoded, job, result, finished)
            making.add_done_callback(lambda done: self._made(job, done.result, finished))
        else:
            self._made(job, lambda: _encoded(job, result, finished), finished)

    def _made(self, job: RequestJob, answer: Callable[[], bytes], finished: float) -> None:
        try:
            data = answer()
        except (codec.WireError, packed.PackingError) as error:
            self.refused(job, RequestError(spec.ErrorCode.INTERNAL, str(error)))
        except Exception as error:  # noqa: BLE001 - a fault of ours must not leave the client waiting
            self.refused(job, fault(error))
        else:
            self._finish(job, data, "ok", finished)

    def raised(self, job: RequestJob, error: AdapterException) -> None:
        """Send what the adapter raised: one sentence, and the traceback only to the log."""
        # What the machine lacks, or what stands in for the model: no fault of the adapter.
        lacks: Payload = {"lacks": error.lacks} if error.lacks else {}
        if error.unserialisable:
            self._errors.note(error.message)
            refused = RequestError(spec.ErrorCode.INTERNAL, f"the result cannot be sent: {error.message}", **lacks)
        elif error.refused:
            refused = RequestError(spec.ErrorCode.INVALID_FRAME, error.message)
        else:
            self._errors.note(error.kind, error.traceback)
            shown = error.traceback if self._debug else f"{error.kind}: {error.message}"
            refused = RequestError(failure_code(job.frame), shown, **lacks)
        self.refused(job, refused)

    def refused(self, job: RequestJob, error: RequestError) -> None:
        """Send why a request was not done."""
        if job.entry is None:
            log(f"reset for a new client failed: {error}")
        self._finish(job, refusal(job.frame, error), error.code, time.monotonic())

    def failed(self, job: RequestJob, error: Exception) -> None:
        """Send that the answer to a request could not be given, unless one was."""
        problem = fault(error)
        self._decoder.release(job)
        if job.entry is not None and job.entry.answer is None:
            job.place.replay.finish(job.frame.message_id, job.entry, refusal(job.frame, problem))

    def _finish(self, job: RequestJob, data: bytes, outcome: str, finished: float) -> None:
        self._decoder.release(job)
        if job.entry is None:
            return
        job.place.replay.finish(job.frame.message_id, job.entry, data)
        self._on_change()
        if self._observer is not None:
            self._observer.answered(job, finished, len(data), outcome)


def _passes(job: RequestJob, result: memoryview) -> bool:
    """Tell whether an answer is passed on as the worker packed it; what is no packed value is not."""
    with contextlib.suppress(packed.PackingError):
        return job.packs and packed.lengths(result)[0] <= spec.LIMITS["packed_header"]
    return False


def acknowledged(frame: codec.Frame, payload: Payload) -> bytes:
    """Return the frame that answers a request."""
    return codec.encode(frame.answer(str(spec.ANSWERS[frame.message_type]), payload))


def refusal(frame: codec.Frame, error: RequestError) -> bytes:
    """Return the error frame that answers a request; there is always one."""
    return codec.encode(frame.answer(spec.Message.ERROR, error.payload()))


def fault(error: Exception) -> RequestError:
    """Return the error answer for a fault of the server itself."""
    told = telling.describe(error)
    log_lines(told["traceback"])
    return RequestError(spec.ErrorCode.INTERNAL, f"fault of the server: {told['type']}: {told['message']}")


def _encoded(job: RequestJob, result: memoryview, finished: float) -> bytes:
    frame = job.frame
    payload: Payload = {} if frame.message_type == spec.Message.INFER else {spec.Payload.OK: True}
    if frame.message_type in _TIMED:
        payload[spec.Payload.LATENCY_MS] = 1000.0 * (finished - job.arrived)
    if _passes(job, result):
        return codec.encode(frame.answer(str(spec.ANSWERS[frame.message_type]), payload), [result])
    return acknowledged(frame, {**payload, **packed.decode(result)})


def _count(place: WorkerSlot, frame: codec.Frame) -> None:
    """Check that no request is missing, or came a second time under another id."""
    number = frame.payload.get(spec.Payload.SEQUENCE)
    if type(number) is not int or number != place.sequence:
        raise RequestError(
            spec.ErrorCode.INTERNAL,
            f"expected request {place.sequence}, got {number!r:.40}: one is missing, or came under two ids",
            spec.ErrorReason.OUT_OF_ORDER,
        )
    place.sequence += 1
