"""What the server says of itself in answer to hello, and how it comes to share memory with a client."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl.client import agreement
from xpl.wire.segment import Segment, SegmentError
from xpl_cli import __version__
from xpl_cli.serving.requests import RequestError
from xpl_cli.serving.server_log import log

if TYPE_CHECKING:
    from xpl.contract import Announcement, Payload
    from xpl.wire import codec
    from xpl_cli.serving.connection import Connection
    from xpl_cli.serving.workers.worker import ModelWorker

_segments = itertools.count(1)
_TRY_AGAIN = 1012  # service restart; registered in the WebSocket close code registry


_PLAIN = (bool, int, float, str, bytes, type(None))
_ENTRIES = 256
"""Of all maps and lists in what a client announces of itself."""


def capabilities(frame: codec.Frame) -> Announcement:
    """Return what a client announced in hello: maps, lists, text and numbers, a few of them.

    Raises:
        RequestError: `invalid_frame` if it is anything else.
    """
    given = frame.payload.get(spec.Payload.CAPABILITIES)
    if given is None:
        return {}
    if not isinstance(given, dict):
        raise _invalid_hello(spec.Payload.CAPABILITIES, f"must be a map, got {type(given).__name__}")
    inside, entries = list(given.values()), 0
    while inside:
        value = inside.pop()
        entries += 1
        if isinstance(value, dict):
            inside.extend(value.values())
        elif isinstance(value, list):
            inside.extend(value)
        elif type(value) not in _PLAIN:
            kind = type(value).__name__
            raise _invalid_hello(spec.Payload.CAPABILITIES, f"must hold text, numbers, lists, maps, got {kind}")
        elif isinstance(value, str | bytes) and len(value) > spec.LIMITS["identifier"]:
            raise _invalid_hello(spec.Payload.CAPABILITIES, f"may hold texts of {spec.LIMITS['identifier']} characters")
        if entries + len(inside) > _ENTRIES:
            raise _invalid_hello(spec.Payload.CAPABILITIES, f"may have {_ENTRIES} entries")
    return given


def _invalid_hello(part: str, problem: str, *differences: dict[str, Any]) -> RequestError:
    text = f"{part} of hello {problem}"
    return RequestError(spec.ErrorCode.INVALID_FRAME, text, spec.ErrorReason.MISMATCH, differences=list(differences))


def hello_answer(policy: Announcement, state: str, frame: codec.Frame, *, guarded: bool) -> Payload:
    """Return the answer to hello, but for what depends on the client's place.

    Args:
        policy: what the policy needs.
        state: of the server.
        frame: the hello.
        guarded: whether clients have to show a token.

    Raises:
        RequestError: `mismatch` if policy and environment do not fit; `invalid_frame` if what the environment says of
            itself is not what it should be.
    """
    try:
        offered = agreement.validate_announcement(frame.payload.get(spec.Payload.ENVIRONMENT))
    except agreement.AnnouncementError as error:
        told = {"field": error.field, "policy": None, "environment": None, "message": str(error)}
        raise _invalid_hello(spec.Payload.ENVIRONMENT, f"cannot be understood: {error}", told) from None
    if offered.get(agreement.REAL_TIME) and not guarded:
        text = "the environment runs in real time, and this server asks for no token: start it with --token-file"
        difference = {"field": agreement.REAL_TIME, "policy": None, "environment": True, "message": text}
        raise RequestError(spec.ErrorCode.INVALID_FRAME, text, spec.ErrorReason.MISMATCH, differences=[difference])
    found = agreement.differences(policy, offered)
    if found:
        raise RequestError(
            spec.ErrorCode.INVALID_FRAME,
            agreement.format_differences(found),
            spec.ErrorReason.MISMATCH,
            differences=found,
        )
    return {
        spec.Payload.OK: True,
        spec.Payload.SERVER: f"xpl {__version__}",
        spec.Payload.STATE: state,
        spec.Payload.POLICY: policy,
        spec.Payload.CAPABILITIES: {
            spec.Capability.WIRE_VERSION: spec.WIRE_VERSION,
            spec.Capability.JPEG_MARKER: True,
            spec.Capability.LOADING: True,
            spec.Capability.PACKED: 1,
            spec.Capability.SEQUENCE: True,
        },
    }


def share_memory(connection: Connection, worker: ModelWorker, asked: Any) -> Payload | None:
    """Offer memory to a client on this host; when it has proved that it sees it, have the worker map it.

    Args:
        connection: the client.
        worker: who serves it.
        asked: what it announced about shared memory; `{"proof": token}` is the second step.

    Returns:
        what to announce about shared memory, or None.
    """
    if not asked or not connection.is_local or not worker.shares_memory:
        return None
    if connection.segment is None:
        return _offer_segment(connection)
    if connection.segment_number is None and isinstance(asked, dict):
        return _verify_proof(connection, connection.segment, worker, asked.get("proof"))
    return None


def _offer_segment(connection: Connection) -> Payload | None:
    try:
        connection.segment = Segment()
    except SegmentError as error:
        log(str(error))
        return None
    return {"path": str(connection.segment.path), "size": connection.segment.size}


def _verify_proof(connection: Connection, segment: Segment, worker: ModelWorker, proof: Any) -> Payload | None:
    if proof != segment.token.hex():
        segment.close()
        return None
    number, shown = next(_segments), segment.answer().hex()
    connection.segment_number = number

    def mapped(error: str | None) -> None:
        segment.close()  # unlinked: whoever dies from now on, the system clears up
        if worker.failed:
            return
        if error is not None:  # no descriptors left, for example
            log(f"the worker cannot share memory: {error}")
            worker.shares_memory = False
            connection.close(_TRY_AGAIN, "the worker cannot share memory")
        elif not connection.is_open:
            worker.send_control({"op": "unmap", "segment": number}, lambda _: None)

    # An errand: done before anything that this client asks for, but not waited for, because the model may be at work.
    worker.send_control({"op": "map", "segment": number, "path": str(segment.path), "size": segment.size}, mapped)
    return {"proof": shown}
