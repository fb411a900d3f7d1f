"""What the two clients have in common: how they are made, and what they tell about the server."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Callable

from xpl import _spec as spec
from xpl.client import wires
from xpl.client.labels import UNSAID, Labels, Unsaid, timing
from xpl.client.transport import Address, Setup, Transport, Wishes

if TYPE_CHECKING:
    import ssl

    from xpl.client.conversation import Conversation
    from xpl.contract import Announcement, Config


class ClientBase:
    """A client before it is connected; `xpl.client.Client` documents the arguments."""

    def __init__(  # noqa: PLR0913 - keywords only
        self,
        url: str,
        *,
        evaluation_id: str | None = None,
        trial_id: str | None = None,
        action_case_id: str | None = None,
        repeat_index: int | None = None,
        config: Config | None = None,
        token: str | None = None,
        ssl_context: ssl.SSLContext | None = None,
        environment: Announcement | None = None,
        jpeg: Mapping[str, int] | None = None,
        pipelined: bool = False,
        shared_memory: bool = True,
        packed: bool = True,
        on_loading: Callable[[Mapping[str, Any]], None] | None = None,
        ws_ping_interval_s: float | Unsaid | None = UNSAID,
        ws_ping_timeout_s: float | Unsaid | None = UNSAID,
        connect_timeout_s: float | None = None,
        handshake_timeout_s: float | None = None,
        request_timeout_s: float | None = None,
        max_connect_attempts: int | None = None,
        connect_retry_delay_s: float | None = None,
        max_connect_seconds: float | None = None,
        close_timeout_s: float | None = None,
        client: Any = None,
    ) -> None:
        if client is not None:
            self._share(client)
            return
        wishes = Wishes(
            packed=packed,
            shared_memory=shared_memory,
            pipelined=pipelined,
            jpeg=jpeg or {},
            environment=environment,
            on_loading=on_loading,
        )
        limits = timing(
            {
                spec.Deploy.CONNECT_TIMEOUT_S: connect_timeout_s,
                spec.Deploy.HANDSHAKE_TIMEOUT_S: handshake_timeout_s,
                spec.Deploy.REQUEST_TIMEOUT_S: request_timeout_s,
                spec.Deploy.MAX_CONNECT_ATTEMPTS: max_connect_attempts,
                spec.Deploy.CONNECT_RETRY_DELAY_S: connect_retry_delay_s,
                spec.Deploy.MAX_CONNECT_SECONDS: max_connect_seconds,
                spec.Deploy.CLOSE_TIMEOUT_S: close_timeout_s,
            },
            {
                spec.Deploy.WS_PING_INTERVAL_S: ws_ping_interval_s,
                spec.Deploy.WS_PING_TIMEOUT_S: ws_ping_timeout_s,
            },
        )
        settings = {**spec.DEPLOY_DEFAULTS, **(config or {}), **limits}
        name, wire, address = wires.of(url, settings)
        self._labels = Labels(evaluation_id or uuid.uuid4().hex, trial_id, action_case_id, repeat_index)
        self._made()
        there = Address(address, settings, None if token is None else f"{wire.scheme} {token}", ssl_context)
        setup = Setup(name, address, settings, self._labels, wishes, lambda: self._transport(there))
        self._talk: Conversation = _conversation(wire, setup)
        self._begin()

    def _share(self, client: Any) -> None:
        """Use the connection of another client, with its names; closing either one closes it.

        Raises:
            TypeError: it is no client of this class.
        """
        if not isinstance(client, type(self)):
            raise TypeError(
                f"client must be an xpl.{type(self).__name__} that is connected, got {type(client).__name__}: "
                "inner clients of other packages speak for themselves"
            )
        vars(self).update(vars(client))

    def _made(self) -> None:
        """Make what calls take turns with."""
        raise NotImplementedError

    def _transport(self, there: Address) -> Transport:
        """Return what carries the messages, not yet open."""
        raise NotImplementedError

    def _begin(self) -> None:
        """Do what a new client does at once."""

    @property
    def evaluation_id(self) -> str:
        """What the evaluation is called."""
        return self._labels.evaluation_id

    @property
    def trial_id(self) -> str | None:
        """What the trial is called; it may be set before the next one begins."""
        return self._labels.trial_id

    @trial_id.setter
    def trial_id(self, name: str | None) -> None:
        self._labels.trial_id = name

    @property
    def action_case_id(self) -> str | None:
        """What the case is called; it may be set before the next one."""
        return self._labels.action_case_id

    @action_case_id.setter
    def action_case_id(self, name: str | None) -> None:
        self._labels.action_case_id = name

    @property
    def repeat_index(self) -> int | None:
        """How often the case was tried before; it may be set before the next trial."""
        return self._labels.repeat_index

    @repeat_index.setter
    def repeat_index(self, count: int | None) -> None:
        self._labels.repeat_index = count

    @property
    def server_instance_id(self) -> str | None:
        """What the server calls itself; None for one of the first generation, or of another wire."""
        return self._talk.server_instance_id

    @property
    def capabilities(self) -> Mapping[str, Any]:
        """What the server announced that it can do."""
        return self._talk.capabilities

    @property
    def policy(self) -> Announcement:
        """What the policy needs, where the server said so."""
        return self._talk.policy

    @property
    def metadata(self) -> Mapping[str, Any]:
        """What a server of another wire said of itself first."""
        return self._talk.metadata


def _conversation(wire: wires.Wire, setup: Setup) -> Conversation:
    if wire.conversation is not None:
        return wire.conversation(setup)
    if wire.codec is None:
        raise TypeError(f"the wire {setup.wire} has neither a conversation nor a codec")
    from xpl.client.request_reply import RequestReply

    return RequestReply(setup, wire.codec(setup.config))
