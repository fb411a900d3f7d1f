"""policy-websocket: a client and a server of openpi's family, with a codec of its own that copies what it decodes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from benchmarks.serving_bench.ends.openpi import ClientPolicyConnection, serve_with

if TYPE_CHECKING:
    from benchmarks.serving_bench.ends import Ready
    from benchmarks.serving_bench.model import Model


def serve(model: Model, setting: str, ready: Ready) -> None:  # noqa: ARG001 - it has one setting
    """Serve with its server."""
    from policy_websocket import WebsocketPolicyServer

    serve_with(WebsocketPolicyServer, model, ready)


async def connect(address: str, setting: str) -> ClientPolicyConnection:  # noqa: ARG001 - it has one setting
    """Connect with its client."""
    from policy_websocket import WebsocketClientPolicy

    return ClientPolicyConnection(WebsocketClientPolicy(host=address))
