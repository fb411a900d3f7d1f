"""By which names a server may be asked, and by which web pages: what a browser sends tells a page from a client.

A page that somebody visits can open a WebSocket to this machine, or give a name of its own this machine's address. It
cannot hide either: browsers send the page's `Origin`, and the name that was looked up as `Host`. Clients that are no
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
"""What a server may listen on without being asked for a token."""

_WILDCARDS = frozenset(("", "*", "0.0.0.0", "::"))  # noqa: S104 - compared with
_AUTHORITY = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(?::\d{1,5})?", re.ASCII)
_ORIGIN = re.compile(rf"[a-z][a-z0-9+.-]*://{_AUTHORITY.pattern}", re.ASCII | re.IGNORECASE)


@dataclass(frozen=True)
class AllowedHosts:
    """The names and pages of one server.

    Args:
        bound: where it listens, as it was told.
        hosts: further names that it goes by.
        origins: pages that may speak to it, as `scheme://name:port`.

    Raises:
        UserError: for a name that is none, or a page that is none.
    """

    listen_host: str
    hosts: Sequence[str] = ()
    origins: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Check what a user gave."""
        for name in self.hosts:
            if _host_name(name) is None or (":" in name and not _is_address(name.strip("[]"))):
                raise UserError(f"--allow-host takes a name without a port, such as gpu-7.lab, got {name!r}")
        for origin in self.origins:
            if _ORIGIN.fullmatch(origin) is None:
                raise UserError(f"--allow-origin takes scheme://name:port, such as https://lab.example, got {origin!r}")

    def origin_refusal(self, origins: Sequence[str]) -> str | None:
        """Return why a request with these `Origin` headers is not let in, or None."""
        if not origins:
            return None
        if len(origins) == 1:
            (origin,) = origins
            found = _ORIGIN.fullmatch(origin)
            known = {allowed.lower() for allowed in self.origins}
            if origin.lower() in known or (found is not None and self._is_own(found[1])):
                return None
        told = ", ".join(origins)
        return f"pages of {told!a:.80} may not speak to this server; --allow-origin names those that may"

    def host_refusal(self, hosts: Sequence[str]) -> str | None:
        """Return why a request with these `Host` headers is not let in, or None."""
        name = _host_name(hosts[0]) if len(hosts) == 1 else None
        # A number is nobody's to give away. A name is, and who owns it may have it stand for this machine.
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
    """Return the name in a `Host` header, without its port; None if it is none."""
    found = _AUTHORITY.fullmatch(header)
    return None if found is None else found[1]


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
