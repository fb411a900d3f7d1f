"""Clients of a policy server, blocking and for asyncio, and their errors.

A client's module is imported when it is first used: the errors alone need no websockets.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl.client.errors import (
    ClientError,
    EnvironmentMismatchError,
    NoOperationError,
    PolicyServerError,
    RequestTimeoutError,
    ServerConnectionError,
    ServerFailedError,
    ServerRestartedError,
)

if TYPE_CHECKING:
    from xpl.client.aio import AsyncClient
    from xpl.client.client import Client

__all__ = [
    "AsyncClient",
    "Client",
    "ClientError",
    "EnvironmentMismatchError",
    "NoOperationError",
    "PolicyServerError",
    "RequestTimeoutError",
    "ServerConnectionError",
    "ServerFailedError",
    "ServerRestartedError",
]

_HOME = {"AsyncClient": "xpl.client.aio", "Client": "xpl.client.client"}


def __getattr__(name: str) -> Any:
    """Import a client from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module 'xpl.client' has no attribute {name!r}; it offers {', '.join(__all__)}")
    import importlib

    return getattr(importlib.import_module(_HOME[name]), name)
