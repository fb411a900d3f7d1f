"""Connecting, again and again while nobody listens, within what deploy.yml allows; and the deadlines that bound it."""

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
"""Reasons of a server that may answer otherwise a little later."""


async def connected(
    once: Callable[[], Coroutine[Any, Any, _Value]],
    pause: Callable[[float], Awaitable[None]],
    config: Config,
    server: str,
    deadline: float,
) -> _Value:
    """Return what connecting once returns, and try again while nobody listens, the model loads or the server is busy.

    Args:
        once: connects; what stands in the way for good it raises as another error than those that pass.
        pause: lets so many seconds pass.
        config: values of deploy.yml: how many attempts, and how long between them.
        server: what is connected to, in words.
        deadline: time after which no further attempt begins.

    Raises:
        ServerConnectionError: attempts or time are used up.
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
                told = f"no {server} after {attempt} attempts: {error}"
                raise ServerConnectionError(told) from None
        await pause(delay)
    raise AssertionError("the attempts never end by themselves")


def connect_deadline(config: Config) -> float:
    """Return when connecting that begins now is given up."""
    return after(config[spec.Deploy.MAX_CONNECT_SECONDS] or None)


def after(seconds: float | None) -> float:
    """Return the deadline in so many seconds; None is never."""
    return math.inf if seconds is None else time.monotonic() + seconds


def left(deadline: float) -> float | None:
    """Return the seconds until a deadline, None without one."""
    return None if deadline == math.inf else max(0.0, deadline - time.monotonic())
