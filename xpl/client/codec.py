"""Events of a request-reply wire, and the codec between events and messages, without I/O.

A codec serves both ends: `xpl.Client` sends what `encode_request` returns and reads the reply by `decode_reply`, and
`xpl serve --also NAME` does the opposite. Connections, episodes, timeouts and batches are handled elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Union

if TYPE_CHECKING:
    from xpl.contract import Action, Announcement, Config, Observation


@dataclass(frozen=True)
class Infer:
    """A request: one observation of the standard, answered by an action chunk."""

    observation: Observation


@dataclass(frozen=True)
class Reset:
    """A request: a new episode begins; only on wires whose codec `resets`."""


@dataclass(frozen=True)
class Actions:
    """A reply to `Infer`.

    Attributes:
        steps: the action chunk, one map of the standard's action keys for each step.
        latency_ms: inference time, ms; None where the server does not report it.
    """

    steps: Sequence[Action]
    latency_ms: float | None = None


@dataclass(frozen=True)
class ResetDone:
    """A reply to `Reset`."""


@dataclass(frozen=True)
class Failure:
    """A reply to any request that failed.

    Attributes:
        message: one line.
        details: further entries, such as a `traceback`.
    """

    message: str
    details: Mapping[str, Any] = field(default_factory=dict)


Message = Union[bytes, str]
"""A whole message of a WebSocket, binary or text."""
Request = Union[Infer, Reset]
Reply = Union[Actions, ResetDone, Failure]


class Codec:
    """Encodes and decodes the messages of one wire. Stateless.

    Args:
        config: values of deploy.yml, with `manifest`, the parsed policy.yml, where there is one.

    Attributes:
        greets: a server sends a greeting first (`encode_greeting`, `decode_greeting`).
        resets: the wire has a reset message; otherwise each connection is one episode.

    Raises:
        ConfigError: the configuration lacks a value, or one is wrong.
    """

    greets = False
    resets = False

    def __init__(self, config: Config) -> None:
        self.config = config

    def encode_greeting(self, policy: Announcement) -> Message:
        """Return the greeting of a server; `policy` is the announcement of its policy (`xpl.client.agreement`)."""
        raise NotImplementedError

    def decode_greeting(self, message: Message) -> Mapping[str, Any]:
        """Return the greeting of a server as a map.

        Raises:
            WireError: the message is no greeting of this wire.
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
            WireError, ObservationError: the message is no request.
        """
        raise NotImplementedError

    def encode_reply(self, reply: Reply) -> Message:
        """Return the message of a reply.

        Raises:
            ActionError, ValueError: this wire cannot express what the policy returned.
        """
        raise NotImplementedError

    def decode_reply(self, message: Message) -> Reply:
        """Return the reply of a message.

        Raises:
            WireError, ActionError: the message is no reply.
        """
        raise NotImplementedError
