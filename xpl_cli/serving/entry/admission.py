"""Admission of HTTP requests: bearer token, host and origin, number of connections; and the two HTTP pages."""

from __future__ import annotations

import hmac
import json
import os
from dataclasses import dataclass
from http import HTTPStatus
from typing import TYPE_CHECKING

from picows import WSUpgradeResponse, WSUpgradeResponseWithListener

from xpl import _spec as spec
from xpl_cli.serving.server_log import log

if TYPE_CHECKING:
    from collections.abc import Callable

    from multidict import CIMultiDict
    from picows import WSUpgradeRequest

    from xpl_cli.serving.entry.allowed_hosts import AllowedHosts
    from xpl_cli.serving.monitoring import Health

BEARER = "bearer"
"""Authorization scheme of a token (RFC 6750), in lower case."""

_HEALTH, _METRICS = "/healthz", "/metrics"


@dataclass(frozen=True)
class Admission:
    """Admits or refuses the HTTP request that opens a connection.

    Args:
        token: bearer token that clients need, or None.
        allowed_hosts: host names of the server, and web pages that may connect.
        health: returns the server's state.
        metrics: returns the page of metrics; None without metrics.
        make_room: tells whether one more connection is possible; may drop a silent one.
        scheme: authorization scheme of tokens, in lower case; `bearer` always works.
    """

    token: str | None
    allowed_hosts: AllowedHosts
    health: Callable[[], Health]
    metrics: Callable[[], bytes] | None
    make_room: Callable[[], bool]
    scheme: str = BEARER

    def refusal(self, request: WSUpgradeRequest) -> WSUpgradeResponseWithListener | None:
        """Return the response to a refused request, or None to admit it; never raises."""
        try:
            return self._refusal(request)
        except Exception as error:  # noqa: BLE001 - untrusted input must not cause a traceback of the library
            log(f"refused a request that could not be read: {type(error).__name__}: {error}")
            return _page(HTTPStatus.BAD_REQUEST, "the request cannot be read\n", {})

    def _refusal(self, request: WSUpgradeRequest) -> WSUpgradeResponseWithListener | None:
        return self._check_authorisation(request.headers) or self._check_request(request)

    def _check_authorisation(self, headers: CIMultiDict[str]) -> WSUpgradeResponseWithListener | None:
        if self.token is not None and not self._has_token(headers.getall("Authorization", [])):
            return _page(HTTPStatus.UNAUTHORIZED, "a bearer token is needed\n", {"WWW-Authenticate": "Bearer"})
        reason = self.allowed_hosts.origin_refusal(headers.getall("Origin", []))
        # A client with the token may use any host name: a third party's web page does not have the token.
        if reason is None and self.token is None:
            reason = self.allowed_hosts.host_refusal(headers.getall("Host", []))
        if reason is not None:
            return _page(HTTPStatus.FORBIDDEN, reason + "\n", {})
        if not all(value.isascii() for value in headers.values()):
            return _page(HTTPStatus.BAD_REQUEST, "headers must be ASCII\n", {})
        return None

    def _check_request(self, request: WSUpgradeRequest) -> WSUpgradeResponseWithListener | None:
        path = os.fsdecode(request.path).partition("?")[0]
        if path == _HEALTH:
            state = self.health()
            ready = state["state"] == spec.ServerState.READY
            status = HTTPStatus.OK if ready else HTTPStatus.SERVICE_UNAVAILABLE
            return _page(status, json.dumps(state) + "\n", {"Content-Type": "application/json"})
        if path == _METRICS and self.metrics is not None:
            return _page(HTTPStatus.OK, self.metrics(), {"Content-Type": "text/plain; version=0.0.4; charset=utf-8"})
        if not self.make_room():
            return _page(HTTPStatus.SERVICE_UNAVAILABLE, f"{self.health()['connections']} connections are enough\n", {})
        if request.headers.get("Upgrade", "").lower() != "websocket":
            return _page(HTTPStatus.NOT_FOUND, f"there is {_HEALTH}, and a policy server for WebSocket clients\n", {})
        return None

    def _has_token(self, headers: list[str]) -> bool:
        if len(headers) != 1:  # with two headers, a proxy may have checked the other one
            return False
        scheme, _, token = headers[0].partition(" ")
        # Constant time, so that the duration does not reveal a correct prefix.
        right = hmac.compare_digest(token.strip().encode(errors="replace"), (self.token or "").encode())
        return scheme.lower() in (BEARER, self.scheme) and right


def _page(status: HTTPStatus, body: str | bytes, headers: dict[str, str]) -> WSUpgradeResponseWithListener:
    content = body.encode() if isinstance(body, str) else body
    if status == HTTPStatus.OK:
        response = WSUpgradeResponse.create_ok_response(content, headers)
    else:
        response = WSUpgradeResponse.create_error_response(status, content, headers)
    return WSUpgradeResponseWithListener(response, None)
