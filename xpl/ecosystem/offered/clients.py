"""The client of XPolicyLab's evaluation loops, under its names there."""

from __future__ import annotations

from typing import Any, TypeVar

_Client = TypeVar("_Client")


class WsModelClient:
    """Client of a policy server, over the wire of the standard.

    Args:
        url: address of the server, `ws://host:port`.
        evaluation_id, trial_id, action_case_id, repeat_index: identifiers of the evaluation, which all frames carry.
        client: a connected `xpl.Client`, used in place of a new one.
        limits: options of `xpl.Client`: `ws_ping_interval_s`, `request_timeout_s` and so on.
    """

    def __init__(  # noqa: PLR0913, PLR0917 - as loops call it
        self,
        url: str = "",
        evaluation_id: str | None = None,
        trial_id: str | None = None,
        action_case_id: str | None = None,
        repeat_index: int | None = None,
        client: Any = None,
        **limits: Any,
    ) -> None:
        self.evaluation_id, self.trial_id = evaluation_id, trial_id
        self.action_case_id, self.repeat_index = action_case_id, repeat_index
        if client is None:
            from xpl.client import Client

            client = Client(
                url,
                evaluation_id=evaluation_id,
                trial_id=trial_id,
                action_case_id=action_case_id,
                repeat_index=repeat_index,
                **limits,
            )
        self._client = client

    def call(self, func_name: str | None = None, obs: Any = None, **named: Any) -> Any:
        """Run a method of the policy and return what it returns.

        Args:
            func_name: name of the method.
            obs: its argument.
            named: must be empty; a method has one argument, `obs`.

        Raises:
            TypeError: there is another argument, which the server would not get.
        """
        if named:
            raise TypeError(f"call takes func_name and obs, got {', '.join(named)} too: pass it as obs")
        return self._client.call(func_name, obs)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def __enter__(self: _Client) -> _Client:  # noqa: PYI019 - Python 3.9
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class ModelClient(WsModelClient):
    """`WsModelClient` by host and port.

    Args:
        host, port: address of the server.
        timeout: not used: `xpl.Client` has its own timeouts.
    """

    def __init__(self, host: str = "localhost", port: int = 9999, timeout: float = 30) -> None:  # noqa: ARG002 - as above
        super().__init__(f"ws://{host}:{port}")
