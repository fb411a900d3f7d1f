"""What a wire of requests and replies is made of: events, and a codec between them and messages, without I/O.

A codec serves both ends: `xpl.Client` sends what `encode_request` returns and reads the reply by `decode_reply`, and
`xpl serve --also NAME` does the opposite. Connections, episodes, limits in time and batches are not its business.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Union

if TYPE_CHECKING:
    from xpl.contract import Action, Announcement, Config, Observation


@dataclass(frozen=True)
class Infer:
    """A request: one observation of the standard, and an action chunk is expected."""

    observation: Observation


@dataclass(frozen=True)
class Reset:
    """A request: a new episode begins; only on wires whose codec `resets`."""


@dataclass(frozen=True)
class Actions:
    """A reply to `Infer`.

    Attributes:
        steps: the action chunk, one map of the standard's action keys for each step.
        latency_ms: what the policy took, ms, where the server says so.
    """

    steps: Sequence[Action]
    latency_ms: float | None = None


@dataclass(frozen=True)
class Done:
    """A reply to `Reset`."""


@dataclass(frozen=True)
class Failure:
    """A reply to any request that failed.

    Attributes:
        message: one line.
        details: what else is known, such as a `traceback`.
    """

    message: str
    details: Mapping[str, Any] = field(default_factory=dict)


Message = Union[bytes, str]
"""A whole message of a WebSocket, binary or text."""
Request = Union[Infer, Reset]
Reply = Union[Actions, Done, Failure]


class Codec:
    """One wire: its messages, both ways. Made of a configuration, and then without state.

    Args:
        config: values of deploy.yml, with `manifest`, the parsed policy.yml, where there is one.

    Attributes:
        greets: a server says something first (`encode_greeting`, `decode_greeting`).
        resets: there is a message by which a client begins an episode; otherwise each connection is one.

    Raises:
        ConfigError: a configuration says too little, or what is wrong.
    """

    greets = False
    resets = False

    def __init__(self, config: Config) -> None:
        self.config = config

    def encode_greeting(self, policy: Announcement) -> Message:
        """Return what a server says first; `policy` is what is told of its policy (`xpl.client.agreement`)."""
        raise NotImplementedError

    def decode_greeting(self, message: Message) -> Mapping[str, Any]:
        """Return what a server said first, as a map.

        Raises:
            WireError: it is no greeting of this wire.
        """
        raise NotImplementedError

    def encode_request(self, request: Request) -> Message:
        """Return the message of a request.

        Raises:
            ObservationError: the observation lacks what this wire sends.
        """
        raise NotImplementedError

    def decode_request(self, message: Message) -> Request:
        """Return the request of a message.

        Raises:
            WireError, ObservationError: it is none.
        """
        raise NotImplementedError

    def encode_reply(self, reply: Reply) -> Message:
        """Return the message of a reply.

        Raises:
            ActionError, ValueError: what the policy returned has no form here.
        """
        raise NotImplementedError

    def decode_reply(self, message: Message) -> Reply:
        """Return the reply of a message.

        Raises:
            WireError, ActionError: it is none.
        """
        raise NotImplementedError
