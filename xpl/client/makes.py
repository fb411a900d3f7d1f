"""Policy servers of other makes: what is spoken here, what is not yet, and how one is recognised by its first word."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xpl import _spec as spec
from xpl.wire import codec

XPL, OPENPI = "xpl", "openpi"
WIRES = (XPL, OPENPI)
"""Wires that a client can speak."""
WIRE = "wire"
"""The key of deploy.yml that says which one `server` speaks."""
_SERVER = "server"
SPOKEN = (
    "spoken here are xpl's wire, older servers of XPolicyLab included, and openpi's; GR00T's ZeroMQ, LeRobot's gRPC "
    "and JSON over HTTP are not spoken yet"
)
"""What a user is told where something else answers."""


def wire_of(url: str, config: Mapping[str, Any]) -> str:
    """Return the wire of an address: `wire` of a configuration is that of its `server`, and of no other.

    Whoever asks an adapter that forwards does so with the same deploy.yml, and speaks xpl's wire.

    Raises:
        ConfigError: if it is not spoken here.
    """
    from xpl.policy import ConfigError

    wire: Any = (config.get(WIRE) if config.get(_SERVER) == url else None) or XPL
    if wire not in WIRES:
        raise ConfigError(f"{WIRE} must be one of {', '.join(WIRES)}, got {wire!r}; {SPOKEN}")
    return str(wire)


def check(url: str, config: Mapping[str, Any]) -> None:
    """Check that an address speaks xpl's wire, where nothing else is spoken.

    Raises:
        ConfigError: otherwise.
    """
    from xpl.policy import ConfigError

    if wire_of(url, config) != XPL:
        raise ConfigError(f"{WIRE}: {config[WIRE]} is spoken by xpl.Client, and by no other client")


def greeting(data: bytes, address: str) -> codec.Frame:
    """Return the frame with which a server answers hello.

    Args:
        data: the message.
        address: where it came from.

    Raises:
        WireError: if it is no frame of xpl's wire, with what it is instead.
    """
    try:
        return codec.decode(data)
    except codec.WireError as error:
        if not is_openpi(data):
            raise codec.WireError(f"the server at {address} sent no frame of xpl's wire: {error}; {SPOKEN}") from None
        raise codec.WireError(
            f"the server at {address} speaks openpi's wire, for it sent its metadata before it was asked; say `{WIRE}: "
            f"{OPENPI}` beside `{_SERVER}` in deploy.yml, and as `{OPENPI}` there what its names mean"
        ) from None


def is_openpi(data: bytes) -> bool:
    """Tell whether a message is the metadata of an openpi server: a map that is no frame, and no error frame either."""
    from xpl.openpi.codec import unpack

    try:
        value: Any = unpack(data)
    except codec.WireError:
        return False
    return isinstance(value, Mapping) and not {spec.Frame.MESSAGE_TYPE, spec.Frame.MESSAGE_ID} & value.keys()
