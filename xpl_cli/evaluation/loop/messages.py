"""What the process of an evaluation loop sends (`xpl.loop.worker`), read where it comes in; none of it is trusted."""

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
    """What arrived from the loop's process is none of its messages."""


@dataclass(frozen=True)
class LoopRequest:
    """What a loop asks.

    Attributes:
        whom: `TASK_ENV` or `CLIENT`.
        operation: one that the two offer.
        arguments, options: by place and by name.
        ahead: whether no answer is waited for.
    """

    whom: str
    operation: str
    arguments: list[Any]
    options: dict[str, Any]
    ahead: bool

    @classmethod
    def parse(cls, head: Mapping[str, Any], buffers: Sequence[Data], shared: SharedArrays) -> Self:
        """Return the question in a message.

        Args:
            head: its head.
            buffers: its packed value.
            shared: what the process has been shown.

        Raises:
            OutOfStepError: it is none.
        """
        try:
            whom, operation = head["target"], head["operation"]
            arguments, options = packed.decode(buffers[0], shared.resolve)
        except (LookupError, TypeError, ValueError) as error:
            raise LoopProtocolError(f"the process of its evaluation loop sent no question: {error!s:.200}") from None
        operations = (
            {TASK_ENV: ENV_OPERATIONS, CLIENT: CLIENT_OPERATIONS}.get(whom, ()) if isinstance(whom, str) else ()
        )
        if operation not in operations or not isinstance(arguments, list) or not isinstance(options, dict):
            raise LoopProtocolError(f"the process of its evaluation loop asked for {operation!r:.80}")
        return cls(whom, operation, arguments, options, bool(head.get("pipelined")))


@dataclass(frozen=True)
class LoopException:
    """What a loop, or deploy.py when it was imported, raised; none of its words are more than text.

    Attributes:
        kind: its type.
        message: what it says.
        is_told: whether it is what the loop was answered.
    """

    kind: str
    message: str
    is_told: bool = False

    @classmethod
    def parse(cls, head: object) -> Self:
        """Return what was raised, as far as a message tells it."""
        raised = head.get("raised") if isinstance(head, dict) else None
        raised = raised if isinstance(raised, dict) else {}
        return cls(
            _text(raised.get("type")) or "an exception", _text(raised.get("message")), bool(raised.get("forwarded"))
        )


def parse_message(head: object, buffers: Sequence[Data], shared: SharedArrays) -> LoopRequest | LoopException | None:
    """Return what a loop that plays asks or raised; None where it has returned.

    Raises:
        OutOfStepError: it is none of these.
    """
    if not isinstance(head, dict) or not isinstance(head.get("raised", {}), dict):
        raise LoopProtocolError("the process of its evaluation loop fell out of step")
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
