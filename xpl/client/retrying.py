"""Connecting with retries while no server listens, within the limits of deploy.yml; and deadlines."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Awaitable, Coroutine
from typing import TYPE_CHECKING, Any, Callable, TypeVar

from xpl import _spec as spec
from xpl.client.errors import PolicyServerError, RequestTimeoutError, ServerConnectionError

if TYPE_CHECKING:
    from xpl.contract import Config

_Value = TypeVar("_Value")

AGAIN = (spec.ErrorReason.BUSY, spec.ErrorReason.LOADING)
"""Reasons after which connecting is tried again."""


async def connect_with_retries(
    once: Callable[[], Coroutine[Any, Any, _Value]],
    pause: Callable[[float], Awaitable[None]],
    config: Config,
    server: str,
    deadline: float,
) -> _Value:
    """Return what `once` returns; try again while no server listens, the model loads or the server is busy.

    Args:
        once: connects; a permanent failure raises another error than OSError, RequestTimeoutError, PolicyServerError.
        pause: waits for a number of seconds.
        config: values of deploy.yml: number of attempts, and the delay between them, s.
        server: name of the server in messages.
        deadline: monotonic time, s, after which no further attempt begins.

    Raises:
        ServerConnectionError: no attempts or no time left.
    """
    most = config[spec.Deploy.MAX_CONNECT_ATTEMPTS] or math.inf
    delay = config[spec.Deploy.CONNECT_RETRY_DELAY_S] or 0.0
    for attempt in itertools.count(1):
        try:
            return await once()
        except (OSError, RequestTimeoutError, PolicyServerError) as error:
            if isinstance(error, PolicyServerError) and error.details.get("reason") not in AGAIN:
                raise
            if attempt >= most or time.monotonic() + delay > deadline:
                message = f"no {server} after {attempt} attempts: {error}"
                raise ServerConnectionError(message) from None
        await pause(delay)
    raise AssertionError("the attempts never end by themselves")


def connect_deadline(config: Config) -> float:
    """Return the deadline, monotonic time in s, of connecting that begins now."""
    return deadline_after(config[spec.Deploy.MAX_CONNECT_SECONDS] or None)


def deadline_after(seconds: float | None) -> float:
    """Return the monotonic time in `seconds`; infinity for None."""
    return math.inf if seconds is None else time.monotonic() + seconds


def seconds_left(deadline: float) -> float | None:
    """Return the seconds until a deadline, None without one."""
    return None if deadline == math.inf else max(0.0, deadline - time.monotonic())
