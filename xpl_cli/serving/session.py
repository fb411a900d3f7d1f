"""What the front end decides about a frame, free of I/O: whose turn it is, what was answered before, what to run."""

from __future__ import annotations

import time
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl import wire

if TYPE_CHECKING:
    import asyncio

_OBS_TYPES: dict[str, type] = {spec.Method.UPDATE_OBS: dict, spec.Method.UPDATE_OBS_BATCH: list}

GRACE_S = 10.0
"""How long a lease outlives a connection that was cut: long enough to reconnect, short enough not to block others."""


class RequestError(Exception):
    """A request that is answered by an error frame."""

    def __init__(self, code: str, message: str, reason: str | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.reason = reason

    def payload(self) -> dict[str, Any]:
        """Return the payload of the error frame; a finer reason than the code goes into the details."""
        details = {"reason": self.reason} if self.reason else {}
        return {spec.Payload.CODE: self.code, spec.Payload.MESSAGE: str(self), spec.Payload.DETAILS: details}


@dataclass(frozen=True)
class Operation:
    """What the worker is to do for a request, and how a failure of it is coded."""

    request: dict[str, Any]
    failure: str


def operation(frame: wire.Frame) -> Operation:
    """Return what the worker does for a reset, infer, call, prepare_case or trial_end frame.

    Raises:
        RequestError: `invalid_frame` if the payload lacks what the request needs.
    """
    payload = frame.payload
    kind = frame.message_type
    if kind == spec.Message.INFER:
        observation = payload.get(spec.Payload.OBSERVATION)
        if not isinstance(observation, dict):
            raise RequestError(spec.ErrorCode.INVALID_FRAME, "infer needs a payload with an observation map")
        return Operation({"op": "infer", "observation": observation}, spec.ErrorCode.INFER_FAILED)
    if kind == spec.Message.RESET:
        return Operation(_call(spec.Method.RESET), spec.ErrorCode.RESET_FAILED)
    if kind == spec.Message.CALL:
        return Operation(_contract_call(payload), spec.ErrorCode.CALL_FAILED)
    hook = {spec.Message.PREPARE_CASE: spec.Method.PREPARE_CASE, spec.Message.TRIAL_END: spec.Method.ON_TRIAL_END}[kind]
    return Operation(_call(hook, payload), spec.ErrorCode.CALL_FAILED)


def _contract_call(payload: dict[str, Any]) -> dict[str, Any]:
    name, obs = payload.get(spec.Payload.FUNC_NAME), payload.get(spec.Payload.OBS)
    if not isinstance(name, str) or name.startswith("_"):
        raise RequestError(spec.ErrorCode.INVALID_FRAME, f"call needs the name of a public method, got {name!r}")
    wanted = _OBS_TYPES.get(name)
    if wanted is not None and not isinstance(obs, wanted):
        kind = "map" if wanted is dict else "list"
        raise RequestError(
            spec.ErrorCode.INVALID_FRAME, f"{name} needs a payload with obs, a {kind}; got {type(obs).__name__}"
        )
    if name == spec.Method.GET_ACTION and isinstance(obs, dict):
        return {"op": "infer", "observation": obs}
    if name in (spec.Method.RESET, spec.Method.GET_ACTION):
        return _call(name)
    return _call(name) if obs is None else _call(name, obs)


def _call(method: str, *args: Any) -> dict[str, Any]:
    return {"op": "call", "method": method, "args": list(args)}


@dataclass
class Lease:
    """Who may use the worker: one connection at a time, and for a while the client that lost its connection."""

    grace: float = GRACE_S
    _connection: object | None = None
    _evaluation: str | None = None
    _free_at: float = 0.0

    def take(self, connection: object, evaluation_id: str) -> bool:
        """Give the worker to a connection; return whether to a new client, not one that has it or came back for it.

        Raises:
            RequestError: `busy` if another connection has it, or may still come back for it.
        """
        if self._connection is connection:
            return False
        returning = self._connection is None and self._evaluation == evaluation_id
        if not returning and (self._connection is not None or time.monotonic() < self._free_at):
            raise RequestError(
                spec.ErrorCode.INTERNAL, "the policy server is in use by another client", spec.ErrorReason.BUSY
            )
        self._connection, self._evaluation = connection, evaluation_id
        return not returning

    def release(self, connection: object, *, clean: bool) -> None:
        """Take the worker back; after a cut its client has `grace` seconds to come back."""
        if self._connection is connection:
            self._connection = None
            self._free_at = 0.0 if clean else time.monotonic() + self.grace
            self._evaluation = None if clean else self._evaluation


@dataclass
class Replay:
    """Answers by message id, so that a repeated request is answered and never run again."""

    entries: OrderedDict[str, tuple[str, asyncio.Future[bytes]]] = field(default_factory=OrderedDict)
    size: int = 0

    def find(self, frame: wire.Frame) -> asyncio.Future[bytes] | None:
        """Return the running or finished answer to this id, or None if it is new.

        Raises:
            RequestError: `invalid_frame` if the id was used for another type of request.
        """
        known = self.entries.get(frame.message_id)
        if known is None:
            return None
        if known[0] != frame.message_type:
            text = f"message id {frame.message_id} was used for {known[0]} before and for {frame.message_type} now"
            raise RequestError(spec.ErrorCode.INVALID_FRAME, text, spec.ErrorReason.DUPLICATE_ID)
        return known[1]

    def add(self, frame: wire.Frame, answer: asyncio.Future[bytes]) -> None:
        """Remember the answer to a request while it is computed and, within the limits, afterwards."""
        self.entries[frame.message_id] = (frame.message_type, answer)
        answer.add_done_callback(lambda done: self._finished(frame.message_id, done))

    def forget(self) -> None:
        """Forget all answers: ids are unique for one client only, and some clients merely count."""
        self.entries.clear()
        self.size = 0

    def _finished(self, message_id: str, answer: asyncio.Future[bytes]) -> None:
        if self.entries.get(message_id, (None, None))[1] is not answer:
            return  # forgotten in the meantime
        self.size += _length(answer)
        while self._over():
            oldest, (_, first) = next(iter(self.entries.items()))
            if not first.done():
                return
            del self.entries[oldest]
            self.size -= _length(first)

    def _over(self) -> bool:
        return len(self.entries) > spec.LIMITS["replay_entries"] or (
            self.size > spec.LIMITS["replay_bytes"] and len(self.entries) > 1
        )


def _length(answer: asyncio.Future[bytes]) -> int:
    return 0 if answer.cancelled() or answer.exception() is not None else len(answer.result())
