"""Encoded images of requests: decoded in threads, and never more of them at once than may stay in memory.

A few kilobytes can stand for a hundred megabytes of pixels. What a message unpacks to is therefore read from the
headers of its images first: no message may hold more than it could have held unencoded (`limits.frame_bytes`), and all
that is decoded and not yet answered, of all clients together, takes no more than that either.
"""

from __future__ import annotations

import asyncio
import collections
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl import _spec as spec
from xpl import images
from xpl.observation import ObservationError
from xpl_cli.serving.payloads import without_images
from xpl_cli.serving.requests import RequestError

if TYPE_CHECKING:
    from collections.abc import Callable

    from xpl.contract import Payload
    from xpl_cli.serving.slots import WorkerSlot
    from xpl_cli.serving.workers.job_queue import RequestJob

    Done = Callable[[asyncio.Future[Payload]], None]

MOST = spec.LIMITS["frame_bytes"]
"""Bytes that one message unpacks to, and that all messages in memory have unpacked to, at most."""
_THREADS = max(2, min(8, os.cpu_count() or 1))


@dataclass(eq=False)
class _DecodeRequest:
    """A request whose images are to be decoded.

    Attributes:
        job: the request.
        done: told when they are, or why not.
        size: bytes that they will take, once that is known.
    """

    job: RequestJob
    done: Done
    size: int | None = None


class ImageDecoder:
    """Decodes the images of requests.

    Args:
        most: bytes of decoded images in memory, of requests that are not answered yet; one alone may have more.
    """

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        self._threads = ThreadPoolExecutor(_THREADS, thread_name_prefix="images")
        self._held: dict[RequestJob, int] = {}
        # The places in turns, and the orders of each as they came: a later one must not hold what an earlier one needs.
        self._waiting: dict[WorkerSlot, collections.deque[_DecodeRequest]] = {}

    def decode(self, job: RequestJob, done: Done) -> None:
        """Decode the images of a request's payload, and say so with the payload or the RequestError."""
        order = _DecodeRequest(job, done)
        self._waiting.setdefault(job.place, collections.deque()).append(order)
        sizing = asyncio.get_running_loop().run_in_executor(self._threads, unpacked_size, job.frame.payload)
        sizing.add_done_callback(lambda sized: self._sized(order, sized))

    def release(self, job: RequestJob) -> None:
        """Say that a request was answered, or given up: what its images take is free again."""
        for order in self._waiting.get(job.place, ()):
            if order.job is job:
                self._forget(order)
                break
        if self._held.pop(job, None) is not None:
            self._begin()

    def _forget(self, order: _DecodeRequest) -> None:
        queue = self._waiting[order.job.place]
        queue.remove(order)
        if not queue:
            del self._waiting[order.job.place]

    def _sized(self, order: _DecodeRequest, sized: asyncio.Future[int]) -> None:
        if order not in self._waiting.get(order.job.place, ()):
            return  # given up in the meantime
        problem = sized.exception()
        if problem is None:
            order.size = sized.result()
        else:
            self._forget(order)
            failed: asyncio.Future[Payload] = asyncio.get_running_loop().create_future()
            failed.set_exception(problem)
            order.done(failed)
        self._begin()

    def _begin(self) -> None:
        """Begin what there is room for."""
        for place in list(self._waiting):
            while (queue := self._waiting.get(place)) and (size := queue[0].size) is not None:
                if self._held and sum(self._held.values()) + size > self._most:
                    self._waiting[place] = self._waiting.pop(place)  # another place has the next turn
                    return
                order = queue[0]
                self._forget(order)
                self._held[order.job] = size
                payload = order.job.frame.payload
                decoding = asyncio.get_running_loop().run_in_executor(self._threads, without_images, payload)
                decoding.add_done_callback(order.done)


def unpacked_size(payload: Payload) -> int:
    """Return how many bytes the encoded images of a payload take once they are decoded.

    Raises:
        RequestError: `invalid_frame` if one is damaged, or it is more than a message may hold.
    """
    try:
        pixels = sum(images.pixels_of(payload.get(name)) for name in (spec.Payload.OBSERVATION, spec.Payload.OBS))
    except ObservationError as error:
        raise RequestError(spec.ErrorCode.INVALID_FRAME, str(error)) from None
    size = pixels * spec.COLOR_CHANNELS
    if size > MOST:
        text = f"the encoded images of a message unpack to {size} bytes, and a message may hold {MOST}"
        raise RequestError(spec.ErrorCode.INVALID_FRAME, text)
    return size
