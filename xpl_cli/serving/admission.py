"""Who may speak to the server at all: bearer token and number of connections; and its two plain HTTP pages."""

from __future__ import annotations

import hmac
import json
import os
from dataclasses import dataclass
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

from picows import WSUpgradeResponse, WSUpgradeResponseWithListener

from xpl import _spec as spec

if TYPE_CHECKING:
    from collections.abc import Callable

    from picows import WSUpgradeRequest

_HEALTH, _METRICS = "/healthz", "/metrics"


@dataclass(frozen=True)
class Admission:
    """Answers the HTTP request that opens a connection.

    Args:
        token: what a client has to show, or None.
        health: returns the server's state.
        metrics: returns the page of metrics, or None if there are none.
        connections: returns how many connections there are.
    """

    token: str | None
    health: Callable[[], dict[str, Any]]
    metrics: Callable[[], bytes] | None
    connections: Callable[[], int]

    def refusal(self, request: WSUpgradeRequest) -> WSUpgradeResponseWithListener | None:
        """Return the answer to a request that is not let in, or None."""
        if self.token is not None and not self._knows(request.headers.get("Authorization", "")):
            return _page(HTTPStatus.UNAUTHORIZED, "a bearer token is needed\n", {"WWW-Authenticate": "Bearer"})
        path = os.fsdecode(request.path).partition("?")[0]
        if path == _HEALTH:
            state = self.health()
            ready = state["state"] == spec.ServerState.READY
            status = HTTPStatus.OK if ready else HTTPStatus.SERVICE_UNAVAILABLE
            return _page(status, json.dumps(state) + "\n", {"Content-Type": "application/json"})
        if path == _METRICS and self.metrics is not None:
            return _page(HTTPStatus.OK, self.metrics(), {"Content-Type": "text/plain; version=0.0.4; charset=utf-8"})
        if self.connections() >= spec.LIMITS["connections"]:
            return _page(HTTPStatus.SERVICE_UNAVAILABLE, f"{self.connections()} connections are enough\n", {})
        if request.headers.get("Upgrade", "").lower() != "websocket":
            return _page(HTTPStatus.NOT_FOUND, f"there is {_HEALTH}, and a policy server for WebSocket clients\n", {})
        return None

    def _knows(self, header: str) -> bool:
        scheme, _, shown = header.partition(" ")
        # The time that this takes must not tell how much of it was right.
        right = hmac.compare_digest(shown.strip().encode(errors="replace"), (self.token or "").encode())
        return scheme.lower() == "bearer" and right


def _page(status: HTTPStatus, body: str | bytes, headers: dict[str, str]) -> WSUpgradeResponseWithListener:
    content = body.encode() if isinstance(body, str) else body
    if status == HTTPStatus.OK:
        response = WSUpgradeResponse.create_ok_response(content, headers)
    else:
        response = WSUpgradeResponse.create_error_response(status, content, headers)
    return WSUpgradeResponseWithListener(response, None)
