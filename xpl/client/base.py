"""What the two clients have in common: how they are made, and what they tell about the server."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Callable

from xpl import _spec as spec
from xpl.client import makes
from xpl.client.conversation import Conversation
from xpl.client.exchange import Exchange
from xpl.client.transport import Transport, Wishes

if TYPE_CHECKING:
    import ssl


class ClientBase:
    """A client of xpl's wire before it is connected; `xpl.client.Client` documents the arguments."""

    def __init__(  # noqa: PLR0913 - keywords only
        self,
        url: str,
        *,
        evaluation_id: str | None = None,
        trial_id: str | None = None,
        config: Mapping[str, Any] | None = None,
        token: str | None = None,
        ssl_context: ssl.SSLContext | None = None,
        environment: Mapping[str, Any] | None = None,
        jpeg: Mapping[str, int] | None = None,
        pipelined: bool = False,
        shared_memory: bool = True,
        packed: bool = True,
        on_loading: Callable[[Mapping[str, Any]], None] | None = None,
    ) -> None:
        wishes = Wishes(
            packed=packed,
            shared_memory=shared_memory,
            pipelined=pipelined,
            jpeg=jpeg or {},
            environment=environment,
            on_loading=on_loading,
        )
        timing = {**spec.DEPLOY_DEFAULTS, **(config or {})}
        makes.check(url, timing)
        transport = self._transport(url, timing, token, ssl_context)
        self._exchange = Exchange(transport, url, timing, wishes, evaluation_id, trial_id)
        self._talk = Conversation(self._exchange, trial_id)
        self._made()

    def _transport(
        self, url: str, timing: Mapping[str, Any], token: str | None, ssl_context: ssl.SSLContext | None
    ) -> Transport:
        """Return what carries the messages, not yet open."""
        raise NotImplementedError

    def _made(self) -> None:
        """Do what a new client does at once."""

    @property
    def server_instance_id(self) -> str | None:
        """What the server calls itself; None for one of the first generation."""
        return self._exchange.server_instance_id

    @property
    def capabilities(self) -> Mapping[str, Any]:
        """What the server announced that it can do."""
        return self._exchange.capabilities

    @property
    def policy(self) -> Mapping[str, Any]:
        """What the policy needs, where the server said so."""
        return self._exchange.policy
