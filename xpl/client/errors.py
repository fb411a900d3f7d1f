"""Errors between an environment and a policy server."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xpl import _spec as spec
from xpl.wire import codec, error_text

_CODES = frozenset(value for name, value in vars(spec.ErrorCode).items() if name.isupper())

_INFRASTRUCTURE_REASONS = (
    spec.ErrorReason.WORKER_DIED,
    spec.ErrorReason.SHUTTING_DOWN,
    spec.ErrorReason.NO_EPISODE,
    spec.ErrorReason.OUT_OF_ORDER,
    spec.ErrorReason.DUPLICATE_ID,
)


class ClientError(RuntimeError):
    """Base class of the errors between an environment and a policy server.

    Args:
        text: the message; control characters that a server put into it are escaped, and its length is bounded.

    Attributes:
        is_infrastructure_error: the infrastructure failed, so the trial says nothing about the policy.
    """

    is_infrastructure_error = False

    def __init__(self, text: str = "") -> None:
        super().__init__(error_text.visible(text))


class PolicyServerError(ClientError):
    """The server answered with an error: the policy raised, or refused the request.

    Attributes:
        code: one of the wire's error codes.
        details: further entries, such as a finer `reason`.
    """

    def __init__(self, code: str, message: str, details: Mapping[str, Any] | None = None) -> None:
        super().__init__(f"{code}: {message}")
        self.code = code
        self.details = dict(details or {})
        self.is_infrastructure_error = self.details.get("reason") in _INFRASTRUCTURE_REASONS


class NoOperationError(ClientError, NotImplementedError):
    """The client has no operation of this name; nothing was sent."""


class EnvironmentMismatchError(PolicyServerError):
    """Policy and environment do not fit; `details["differences"]` says where."""


class ServerConnectionError(ClientError):
    """The server cannot be reached, or a connection was lost and the trial cannot go on."""

    is_infrastructure_error = True


class ServerRestartedError(ServerConnectionError):
    """Another server instance answers: the episode's state is lost, and the trial must be aborted."""


class RequestTimeoutError(ClientError):
    """A request was not answered in time; the trial must be aborted."""

    is_infrastructure_error = True


class ServerFailedError(ServerConnectionError):
    """The server closed the connection because its policy cannot go on."""


def error_from_payload(payload: Mapping[str, Any]) -> PolicyServerError:
    """Return the error of a server's answer; an unknown code becomes `internal`.

    Raises:
        WireError: code or reason is present and no text.
    """
    details = payload.get(spec.Payload.DETAILS)
    details = details if isinstance(details, Mapping) else {}
    code, reason = payload.get(spec.Payload.CODE), details.get("reason")
    for name, value in ((spec.Payload.CODE, code), ("reason", reason)):
        if not isinstance(value, (str, type(None))):
            raise codec.WireError(f"the {name} of an error must be text, got {type(value).__name__}")
    kind = EnvironmentMismatchError if reason == spec.ErrorReason.MISMATCH else PolicyServerError
    error_code = code if isinstance(code, str) and code in _CODES else spec.ErrorCode.INTERNAL
    return kind(error_code, str(payload.get(spec.Payload.MESSAGE)), details)
