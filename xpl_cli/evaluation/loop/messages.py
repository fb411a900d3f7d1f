"""Parse the messages of an evaluation loop's process (`xpl.loop.worker`); none of them is trusted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

from xpl.loop.proxies import CLIENT, CLIENT_OPERATIONS, ENV_OPERATIONS, TASK_ENV
from xpl.wire import packed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl.loop.shared_arrays import SharedArrays
    from xpl.wire.arrays import Data

_MAX_TEXT = 500
"""Characters of what an adapter raised that are passed on."""


class LoopProtocolError(Exception):
    """A message of the loop's process is invalid."""


@dataclass(frozen=True)
class LoopRequest:
    """A request of a loop.

    Attributes:
        target: `TASK_ENV` or `CLIENT`.
        operation: of the target.
        arguments, options: positional and keyword arguments.
        ahead: whether the loop waits for no answer.
    """

    target: str
    operation: str
    arguments: list[Any]
    options: dict[str, Any]
    ahead: bool

    @classmethod
    def parse(cls, head: Mapping[str, Any], buffers: Sequence[Data], shared: SharedArrays) -> Self:
        """Return the request in a message.

        Args:
            head: of the message.
            buffers: its packed value.
            shared: arrays that the process has received before.

        Raises:
            LoopProtocolError: the message is invalid.
        """
        try:
            target, operation = head["target"], head["operation"]
            arguments, options = packed.decode(buffers[0], shared.resolve)
        except (LookupError, TypeError, ValueError) as error:
            raise LoopProtocolError(f"its evaluation loop sent an invalid request: {error!s:.200}") from None
        operations = (
            {TASK_ENV: ENV_OPERATIONS, CLIENT: CLIENT_OPERATIONS}.get(target, ()) if isinstance(target, str) else ()
        )
        if operation not in operations or not isinstance(arguments, list) or not isinstance(options, dict):
            raise LoopProtocolError(f"its evaluation loop requested {operation!r:.80}")
        return cls(target, operation, arguments, options, bool(head.get("pipelined")))


@dataclass(frozen=True)
class LoopException:
    """An exception of a loop, or of deploy.py when it was imported; its content is untrusted text.

    Attributes:
        kind: its type.
        message: its text.
        is_reported: whether it is the error that the loop got as an answer.
    """

    kind: str
    message: str
    is_reported: bool = False

    @classmethod
    def parse(cls, head: object) -> Self:
        """Return the exception in a message, as far as the message describes it."""
        raised = head.get("raised") if isinstance(head, dict) else None
        raised = raised if isinstance(raised, dict) else {}
        return cls(
            _text(raised.get("type")) or "an exception", _text(raised.get("message")), bool(raised.get("forwarded"))
        )


def parse_message(head: object, buffers: Sequence[Data], shared: SharedArrays) -> LoopRequest | LoopException | None:
    """Return the request or exception of a running loop; None if it has returned.

    Raises:
        LoopProtocolError: the message is invalid.
    """
    if not isinstance(head, dict) or not isinstance(head.get("raised", {}), dict):
        raise LoopProtocolError("its evaluation loop sent an invalid message")
    if "target" in head:
        return LoopRequest.parse(head, buffers, shared)
    return LoopException.parse(head) if "raised" in head else None


def parse_functions(head: object) -> frozenset[str] | LoopException:
    """Return the names of the functions in a deploy.py that was imported, or what it raised."""
    if not isinstance(head, dict) or not isinstance(head.get("functions"), list):
        return LoopException.parse(head)
    return frozenset(name for name in head["functions"] if isinstance(name, str))


def _text(value: object) -> str:
    """Return a text that can be written down, in one line."""
    text = value if isinstance(value, str) else ""
    return " ".join(text.encode("utf-8", "replace").decode().split())[:_MAX_TEXT]
