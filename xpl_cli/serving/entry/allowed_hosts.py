"""Host names of a server, and web pages that may connect: protection against pages that a user's browser opens.

A web page can open a WebSocket to this machine, or point a name of its own at this machine's address (DNS rebinding).
It cannot hide either: browsers send the page's `Origin`, and the name that was looked up as `Host`. Clients that are no
browsers send no `Origin`.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Sequence

LOOPBACK: Final = ("localhost", "127.0.0.1", "::1")
"""Addresses that a server may listen on without a token."""

_WILDCARDS = frozenset(("", "*", "0.0.0.0", "::"))  # noqa: S104 - for comparison only
_AUTHORITY = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(?::\d{1,5})?", re.ASCII)
_ORIGIN = re.compile(rf"[a-z][a-z0-9+.-]*://{_AUTHORITY.pattern}", re.ASCII | re.IGNORECASE)


@dataclass(frozen=True)
class AllowedHosts:
    """Host names of one server, and web pages that may connect.

    Args:
        listen_host: address that it listens on, as configured.
        hosts: further host names.
        origins: web pages that may connect, as `scheme://name:port`.

    Raises:
        UserError: for a malformed name or origin.
    """

    listen_host: str
    hosts: Sequence[str] = ()
    origins: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Validate names and origins."""
        for name in self.hosts:
            if _host_name(name) is None or (":" in name and not _is_address(name.strip("[]"))):
                raise UserError(f"--allow-host takes a name without a port, such as gpu-7.lab, got {name!r}")
        for origin in self.origins:
            if _ORIGIN.fullmatch(origin) is None:
                raise UserError(f"--allow-origin takes scheme://name:port, such as https://lab.example, got {origin!r}")

    def origin_refusal(self, origins: Sequence[str]) -> str | None:
        """Return why a request with these `Origin` headers is refused, or None."""
        if not origins:
            return None
        if len(origins) == 1:
            (origin,) = origins
            match = _ORIGIN.fullmatch(origin)
            allowed_origins = {allowed.lower() for allowed in self.origins}
            if origin.lower() in allowed_origins or (match is not None and self._is_own(match[1])):
                return None
        return f"pages of {', '.join(origins)!a:.80} may not speak to this server; --allow-origin names those that may"

    def host_refusal(self, hosts: Sequence[str]) -> str | None:
        """Return why a request with these `Host` headers is refused, or None."""
        name = _host_name(hosts[0]) if len(hosts) == 1 else None
        # An IP address has no owner who could point it elsewhere; a name has.
        anywhere = self.listen_host in _WILDCARDS
        if name is not None and (self._is_own(name) or (anywhere and _is_address(name.strip("[]")))):
            return None
        return f"this server does not go by {', '.join(hosts)!a:.80}; --allow-host names what it goes by"

    def _is_own(self, written: str) -> bool:
        name = written.strip("[]").lower().removesuffix(".")
        if name == LOOPBACK[0] or name.endswith("." + LOOPBACK[0]) or name == self.listen_host.lower():
            return True
        if name in {host.strip("[]").lower() for host in self.hosts}:
            return True
        if _is_address(name):
            return ipaddress.ip_address(name).is_loopback
        if self.listen_host in LOOPBACK:
            return False
        machine = socket.gethostname().lower()
        return name in {machine, machine.partition(".")[0], machine.partition(".")[0] + ".local"}


def _host_name(header: str) -> str | None:
    """Return the name in a `Host` header, without its port; None if it is malformed."""
    match = _AUTHORITY.fullmatch(header)
    return None if match is None else match[1]


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
