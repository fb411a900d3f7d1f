"""SDK of the XPolicyLab standard: what adapters and environment clients import.

Imports nothing but the standard library and numpy; `Client` and `AsyncClient` bring in websockets and msgpack when they
are first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from xpl.action import ActionError
    from xpl.client.aio import AsyncClient
    from xpl.client.client import Client
    from xpl.embodiment import Embodiment, get_embodiment
    from xpl.observation import ObservationError
    from xpl.policy import Policy

__all__ = ["ActionError", "AsyncClient", "Client", "Embodiment", "ObservationError", "Policy", "get_embodiment"]

__version__ = "0.1.0"

_HOME = {
    "ActionError": "xpl.action",
    "AsyncClient": "xpl.client.aio",
    "Client": "xpl.client.client",
    "Embodiment": "xpl.embodiment",
    "ObservationError": "xpl.observation",
    "Policy": "xpl.policy",
    "get_embodiment": "xpl.embodiment",
}


def __getattr__(name: str) -> Any:
    """Import a public name from its module on first use, so that `import xpl` stays cheap and free of numpy."""
    if name not in _HOME:
        message = f"module 'xpl' has no attribute {name!r}; it offers {', '.join(__all__)}"
        raise AttributeError(message)
    import importlib

    return getattr(importlib.import_module(_HOME[name]), name)
