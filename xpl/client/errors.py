"""What can go wrong between an environment and a policy server."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xpl import _spec as spec
from xpl.wire import codec, telling

_CODES = frozenset(value for name, value in vars(spec.ErrorCode).items() if name.isupper())

_SPOILING = (
    spec.ErrorReason.WORKER_DIED,
    spec.ErrorReason.SHUTTING_DOWN,
    spec.ErrorReason.NO_EPISODE,
    spec.ErrorReason.OUT_OF_ORDER,
    spec.ErrorReason.DUPLICATE_ID,
)


class ClientError(RuntimeError):
    """Base class of what can go wrong between an environment and a policy server.

    Args:
        text: what went wrong; whatever a server put into it steers no terminal and is bounded.

    Attributes:
        spoils_trial: the infrastructure failed, and the trial says nothing about the policy.
    """

    spoils_trial = False

    def __init__(self, text: str = "") -> None:
        super().__init__(telling.visible(text))


class PolicyServerError(ClientError):
    """The server answered with an error; the policy raised, or refused the request.

    Attributes:
        code: one of the wire's error codes.
        details: map with, for example, a finer `reason`.
    """

    def __init__(self, code: str, message: str, details: Mapping[str, Any] | None = None) -> None:
        super().__init__(f"{code}: {message}")
        self.code = code
        self.details = dict(details or {})
        self.spoils_trial = self.details.get("reason") in _SPOILING


class NoOperationError(ClientError, NotImplementedError):
    """What was called is the name of no operation that anybody may call; nothing was sent."""


class EnvironmentMismatchError(PolicyServerError):
    """Policy and environment do not fit; `details["differences"]` says where."""


class ServerConnectionError(ClientError):
    """The server cannot be reached, or a connection was lost and the trial cannot go on."""

    spoils_trial = True


class ServerRestartedError(ServerConnectionError):
    """Another server instance answers now: the episode's state is gone, the trial must be aborted."""


class RequestTimeoutError(ClientError):
    """A request was not answered in time; the trial must be aborted."""

    spoils_trial = True


class ServerFailedError(ServerConnectionError):
    """The server closed the connection because its policy cannot go on."""


def of_answer(payload: Mapping[str, Any]) -> PolicyServerError:
    """Return the error that a server answers with; a code of another generation stands for one of its own.

    Raises:
        WireError: code or reason is there and no text.
    """
    details = payload.get(spec.Payload.DETAILS)
    details = details if isinstance(details, Mapping) else {}
    code, reason = payload.get(spec.Payload.CODE), details.get("reason")
    for name, value in ((spec.Payload.CODE, code), ("reason", reason)):
        if not isinstance(value, (str, type(None))):
            raise codec.WireError(f"the {name} of an error must be text, got {type(value).__name__}")
    kind = EnvironmentMismatchError if reason == spec.ErrorReason.MISMATCH else PolicyServerError
    known = code if isinstance(code, str) and code in _CODES else spec.ErrorCode.INTERNAL
    return kind(known, str(payload.get(spec.Payload.MESSAGE)), details)
