"""Attribute a broken rollout: to the policy, whose process ended or hung, or to the infrastructure.

An infrastructure error is only what is observed outside of the adapter's processes: the server's front end, the
environment's process or the network is lost. A policy that ends itself when it is about to fail gains nothing by it.
"""

from __future__ import annotations

import contextlib
import http.client
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from xpl import _spec as sdk
from xpl.client import ClientError, PolicyServerError, RequestTimeoutError, ServerFailedError
from xpl_cli.evaluation.loop.process import LoopLostError

if TYPE_CHECKING:
    import ssl

    from xpl.contract import Config

_OUTSIDE = (sdk.ErrorReason.SHUTTING_DOWN,)
"""Reasons of an answer in which the front end speaks of itself."""
_ANSWER_S = 5.0
_LONGER_S = 10.0
"""What a client waits beyond its server's own limit for a batch."""


def is_policy_crash(error: Exception, url: str, ssl_context: ssl.SSLContext | None = None) -> bool:
    """Return whether an error shows that a process with the adapter's code ended or hung.

    Args:
        error: what ended the episode.
        url: of the policy server.
        ssl_context: for `wss://`.
    """
    if isinstance(error, (LoopLostError, ServerFailedError)):
        return True
    if isinstance(error, PolicyServerError):
        return error.code == sdk.ErrorCode.TIMEOUT or error.details.get("reason") == sdk.ErrorReason.WORKER_DIED
    return isinstance(error, RequestTimeoutError) and is_responding(url, ssl_context)


def with_longer_timeout(config: Config) -> dict[str, Any]:
    """Return a configuration in which the client's request timeout is longer than the server's.

    A server reports that it ended a hanging worker if the client still waits for the answer; then the server may end,
    too, and a policy that hangs could not be told from a machine that failed.
    """
    limit = config.get(sdk.Deploy.REQUEST_TIMEOUT_S)
    return dict(config) if limit is None else {**config, sdk.Deploy.REQUEST_TIMEOUT_S: limit + _LONGER_S}


def is_infrastructure_error(error: ClientError) -> bool:
    """Return whether an error of a client, other than a policy crash, is an infrastructure error."""
    if isinstance(error, PolicyServerError):
        return error.details.get("reason") in _OUTSIDE
    return error.is_infrastructure_error


def is_responding(url: str, ssl_context: ssl.SSLContext | None = None) -> bool:
    """Return whether the front end of a server responds, with whatever status: then it is the model that hangs."""
    address = urlsplit(url)
    host, port = address.hostname or "", address.port
    with contextlib.suppress(OSError, http.client.HTTPException):
        if address.scheme == "wss":
            connection: http.client.HTTPConnection = http.client.HTTPSConnection(
                host, port, timeout=_ANSWER_S, context=ssl_context
            )
        else:
            connection = http.client.HTTPConnection(host, port, timeout=_ANSWER_S)
        with contextlib.closing(connection):
            connection.request("GET", "/healthz")
            connection.getresponse()
            return True
    return False
