"""Decode the images of requests in threads, within a limit on the memory of decoded images.

A few kilobytes can stand for a hundred megabytes of pixels. The decoder therefore reads the unpacked size from the
headers of the images first: no message may unpack to more than `limits.frame_bytes`, and neither may all messages
together, of all clients, that are decoded and not yet answered.
"""

from __future__ import annotations

import asyncio
import collections
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl import _spec as spec
from xpl import image_codec
from xpl.observation import ObservationError
from xpl_cli.serving.payloads import decode_images
from xpl_cli.serving.requests import RequestError

if TYPE_CHECKING:
    from collections.abc import Callable

    from xpl.contract import Payload
    from xpl_cli.serving.slots import WorkerSlot
    from xpl_cli.serving.workers.job_queue import RequestJob

    Done = Callable[[asyncio.Future[Payload]], None]

MAX_UNPACKED_BYTES = spec.LIMITS["frame_bytes"]
"""Largest unpacked size of one message, and of all messages in memory."""
_THREADS = max(2, min(8, os.cpu_count() or 1))


@dataclass(eq=False)
class _DecodeRequest:
    """A request whose images are to be decoded.

    Attributes:
        job: the request.
        on_decoded: called with the payload or the error.
        size: bytes of the decoded images; None until they are known.
    """

    job: RequestJob
    on_decoded: Done
    size: int | None = None


class ImageDecoder:
    """Decodes the images of requests.

    Args:
        max_bytes: bytes of decoded images of unanswered requests; a single request may have more.
    """

    def __init__(self, max_bytes: int = MAX_UNPACKED_BYTES) -> None:
        self._max_bytes = max_bytes
        self._threads = ThreadPoolExecutor(_THREADS, thread_name_prefix="images")
        self._decoded_bytes: dict[RequestJob, int] = {}
        # Slots take turns, each with its requests in order: no later request holds memory that an earlier one needs.
        self._waiting: dict[WorkerSlot, collections.deque[_DecodeRequest]] = {}

    def decode(self, job: RequestJob, on_decoded: Done) -> None:
        """Decode the images of a request's payload, and call `on_decoded` with the payload or the RequestError."""
        order = _DecodeRequest(job, on_decoded)
        self._waiting.setdefault(job.slot, collections.deque()).append(order)
        sizing = asyncio.get_running_loop().run_in_executor(self._threads, unpacked_size, job.frame.payload)
        sizing.add_done_callback(lambda sized: self._set_size(order, sized))

    def release(self, job: RequestJob) -> None:
        """Free the memory of a request that was answered or given up."""
        for order in self._waiting.get(job.slot, ()):
            if order.job is job:
                self._remove(order)
                break
        if self._decoded_bytes.pop(job, None) is not None:
            self._start_decoding()

    def _remove(self, order: _DecodeRequest) -> None:
        queue = self._waiting[order.job.slot]
        queue.remove(order)
        if not queue:
            del self._waiting[order.job.slot]

    def _set_size(self, order: _DecodeRequest, sized: asyncio.Future[int]) -> None:
        if order not in self._waiting.get(order.job.slot, ()):
            return  # given up in the meantime
        problem = sized.exception()
        if problem is None:
            order.size = sized.result()
        else:
            self._remove(order)
            failed: asyncio.Future[Payload] = asyncio.get_running_loop().create_future()
            failed.set_exception(problem)
            order.on_decoded(failed)
        self._start_decoding()

    def _start_decoding(self) -> None:
        """Start decoding what fits into the limit."""
        for slot in list(self._waiting):
            while (queue := self._waiting.get(slot)) and (size := queue[0].size) is not None:
                if self._decoded_bytes and sum(self._decoded_bytes.values()) + size > self._max_bytes:
                    self._waiting[slot] = self._waiting.pop(slot)  # the next slot has the next turn
                    return
                order = queue[0]
                self._remove(order)
                self._decoded_bytes[order.job] = size
                payload = order.job.frame.payload
                decoding = asyncio.get_running_loop().run_in_executor(self._threads, decode_images, payload)
                decoding.add_done_callback(order.on_decoded)


def unpacked_size(payload: Payload) -> int:
    """Return how many bytes the encoded images of a payload take once they are decoded.

    Raises:
        RequestError: `invalid_frame` if one is damaged, or they are larger than the limit.
    """
    try:
        pixels = sum(image_codec.pixels_of(payload.get(name)) for name in (spec.Payload.OBSERVATION, spec.Payload.OBS))
    except ObservationError as error:
        raise RequestError(spec.ErrorCode.INVALID_FRAME, str(error)) from None
    size = pixels * spec.COLOR_CHANNELS
    if size > MAX_UNPACKED_BYTES:
        text = f"the encoded images of a message unpack to {size} bytes, and a message may hold {MAX_UNPACKED_BYTES}"
        raise RequestError(spec.ErrorCode.INVALID_FRAME, text)
    return size
