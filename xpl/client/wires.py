"""Which wires there are: each is a codec, a client and an entrance of the server behind one name.

The name stands in the address (`openpi+ws://host:port`), in `wire` of deploy.yml beside the `server` that speaks it, or
behind `xpl serve --also`. A package adds a wire with an entry point of the group `xpl.wires` (docs/extending.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Callable

from xpl import registry
from xpl.wire import codec

if TYPE_CHECKING:
    from xpl.client.codec import Codec
    from xpl.client.conversation import Conversation
    from xpl.client.transport import Setup
    from xpl.contract import Config

XPL = "xpl"
BUILT_IN = {XPL: "xpl.client.framed:WIRE", "openpi": "xpl.openpi.wire:WIRE"}
"""Our own wires; the first is spoken where nothing else is said."""
WIRE, SERVER = "wire", "server"
"""Keys of deploy.yml: what is spoken by the server at an address, and that address."""


@dataclass(frozen=True)
class Wire:
    """How a policy server and its clients talk.

    Attributes:
        codec: makes the codec of a configuration; None where the server's own frames are spoken.
        conversation: makes a client's side; by default one that asks by the codec, with a connection for each
            environment (`xpl.client.request_reply`).
        scheme: how a token is announced in the header `Authorization`.
        recognises: tells whether what a server says first is of this wire, so that a user is told its name.
        hint: what to do where a configuration says too little for the codec.
    """

    codec: Callable[[Mapping[str, Any]], Codec] | None = None
    conversation: Callable[[Setup], Conversation] | None = None
    scheme: str = "Bearer"
    recognises: Callable[[bytes], bool] | None = None
    hint: str = ""


def names() -> list[str]:
    """Return the names of all wires, ours first."""
    return list(registry.entries(registry.WIRES, BUILT_IN))


def find(name: str) -> Wire | None:
    """Return a wire by its name, None if there is none.

    Raises:
        EntryPointError: it cannot be imported, or is no `Wire`.
    """
    entry = registry.find(registry.WIRES, name, BUILT_IN)
    return None if entry is None else _loaded(entry)


def of(url: str, config: Config) -> tuple[str, Wire, str]:
    """Return the wire of an address, by name and itself, and the address without that name.

    `wire` of a configuration is that of its `server`, and of no other address: whoever asks an adapter that forwards
    does so with the same deploy.yml, and speaks xpl's wire.

    Raises:
        ConfigError: it is not spoken here, or address and configuration say different ones.
    """
    from xpl.policy import ConfigError

    scheme, separator, rest = url.partition("://")
    prefix, plus, transport = scheme.rpartition("+")
    said = config.get(WIRE) if config.get(SERVER) == url else None
    if plus and said is not None and said != prefix:
        raise ConfigError(f"{SERVER} says {prefix!r} and {WIRE} says {said!r}: give the wire in one place")
    name = (prefix if plus else said) or XPL
    wire = find(name) if isinstance(name, str) else None
    if wire is None:
        raise ConfigError(f"{WIRE} must be one of {', '.join(names())}, got {name!r}; {spoken()}")
    return name, wire, transport + separator + rest


def spoken() -> str:
    """Return what a user is told where something else answers."""
    others = ", ".join(name for name in names() if name != XPL)
    return (
        f"spoken here are xpl's wire, older servers of XPolicyLab included, and {others}; GR00T's ZeroMQ, LeRobot's "
        "gRPC and JSON over HTTP are not spoken yet"
    )


def greeting(data: bytes, address: str) -> codec.Frame:
    """Return the frame with which a server answers hello.

    Args:
        data: the message.
        address: where it came from.

    Raises:
        WireError: it is no frame of xpl's wire, with the wire that it is of where one recognises it.
    """
    try:
        return codec.decode(data)
    except codec.WireError as error:
        for entry in registry.entries(registry.WIRES, BUILT_IN).values():
            recognises = _loaded(entry).recognises
            if recognises is not None and recognises(data):
                raise codec.WireError(
                    f"the server at {address} speaks {entry.name}'s wire, by what it sent before it was asked; say "
                    f"`{WIRE}: {entry.name}` beside `{SERVER}` in deploy.yml, or {entry.name}+{address}"
                ) from None
        raise codec.WireError(f"the server at {address} sent no frame of xpl's wire: {error}; {spoken()}") from None


def _loaded(entry: registry.Entry) -> Wire:
    wire = entry.load()
    if not isinstance(wire, Wire):
        raise entry.broken(f"expected an xpl.client.wires.Wire, got {type(wire).__name__}")
    return wire
