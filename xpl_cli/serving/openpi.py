"""`--also openpi`: an entrance of the front end for clients that speak openpi's wire.

Whoever comes through it is a client like any other: it says hello, resets, and asks. This one says hello and resets for
it, puts its observations into the standard's names, and its answers into openpi's. A connection is an episode, for that
wire has no reset.
"""

from __future__ import annotations

import uuid
from typing import TYPE_CHECKING, Any

from picows import WSMsgType

from xpl import _spec as spec
from xpl.action import ActionError
from xpl.observation import ObservationError
from xpl.openpi import codec as openpi
from xpl.openpi.names import ACTIONS, Names
from xpl.wire import codec
from xpl_cli.basics.errors import UserError
from xpl_cli.serving.connection import Connection
from xpl_cli.serving.server import Entrance

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from picows import WSTransport

    from xpl_cli.serving.connection import Owner, Timing

NAME = "openpi"
_SCHEME = "api-key"
"""How its clients announce a token (`Authorization: Api-Key ...`), in lower case."""
_TRY_AGAIN, _REFUSED = 1013, 1008  # WebSocket close codes: RFC 6455, and its registry


def port(also: Sequence[str]) -> int | None:
    """Return the port that `--also` asks for, 0 for any; None if it asks for none.

    Raises:
        UserError: if it asks for something else.
    """
    ports = []
    for one in also:
        name, _, number = one.partition(":")
        if name != NAME or not (number or "0").isdecimal() or int(number or 0) > 65535:
            raise UserError(f"--also takes {NAME}, or {NAME}:PORT; got {one!r}")
        ports.append(int(number or 0))
    if len(ports) > 1:
        raise UserError("--also was given twice: there is one port for openpi's clients")
    return ports[0] if ports else None


def entrances(
    also: Sequence[str], config: Mapping[str, Any], manifest: Mapping[str, Any], policy: Mapping[str, Any]
) -> dict[str, Entrance]:
    """Return the entrances that `--also` asks for, by their names.

    Args:
        also: what was asked for.
        config: values of deploy.yml.
        manifest: the parsed policy.yml.
        policy: what clients are told of the policy.

    Raises:
        UserError: if it cannot be had.
    """
    chosen = port(also)
    if chosen is None:
        return {}
    meaning = names(config, manifest)
    metadata = about(policy, meaning)
    return {NAME: Entrance(chosen, lambda owner, timing: OpenpiConnection(owner, timing, meaning, metadata), _SCHEME)}


def names(config: Mapping[str, Any], manifest: Mapping[str, Any]) -> Names:
    """Return what openpi's names mean to an adapter.

    Raises:
        UserError: if its deploy.yml does not say, or not rightly.
    """
    try:
        return Names.of({**config, "manifest": manifest})
    except (ValueError, LookupError) as error:
        hint = "--set 'openpi={style: droid}', or `openpi:` in deploy.yml; docs/openpi.md has all keys"
        raise UserError(f"--also {NAME}: {error}", hint=hint) from None


class OpenpiConnection(Connection):
    """A peer that speaks openpi's wire.

    Args:
        owner: the front end.
        timing: deadlines.
        meaning: what the names of its observations mean, and the order of its actions.
        about: what it is told of the policy first.
    """

    def __init__(self, owner: Owner, timing: Timing, meaning: Names, about: Mapping[str, Any]) -> None:
        super().__init__(owner, timing)
        self._meaning = meaning
        self._about = about
        self._evaluation = uuid.uuid4().hex
        self._step = 0
        self._asked = 0
        self._told = 0
        self._answers: dict[int, bytes | str] = {}

    def on_ws_connected(self, transport: WSTransport) -> None:
        """Say hello for the peer; that it says nothing before it was greeted is how it is."""
        super().on_ws_connected(transport)
        self._wait_on()
        self._ask(spec.Message.HELLO, {})

    def on_ws_disconnected(self, transport: WSTransport) -> None:
        """Give the place back: this peer has no way to come back to its episode."""
        self._clean = True
        super().on_ws_disconnected(transport)

    def answer(self, data: bytes) -> None:
        """Send what the front end answers, in openpi's form."""
        frame = codec.decode(data)
        if frame.message_type == spec.ANSWERS[spec.Message.HELLO]:
            self._settle()
            self._ask(spec.Message.RESET, {})
        elif frame.message_type == spec.ANSWERS[spec.Message.RESET]:
            self._settle()
            self._heard()
            self._send(openpi.pack(dict(self._about)))
        elif not self._is_greeted(frame):
            self._settle()
            reason = (frame.payload.get(spec.Payload.DETAILS) or {}).get("reason")
            self.close(_TRY_AGAIN if reason == spec.ErrorReason.BUSY else _REFUSED, _sentence(frame))
        else:
            self._answers[int(frame.message_id)] = self._translated(frame)
            self._tell()

    # -- inside --------------------------------------------------------------------------------------------------------

    def _whole(self, data: bytes | memoryview) -> None:
        """Ask the front end about an observation, or say what is wrong with it when its turn has come."""
        try:
            obs = self._meaning.observation(openpi.unpack(bytes(data)))
        except (codec.WireError, ObservationError) as error:
            self.expect_answer(len(data))
            self._answers[self._next()] = f"{type(error).__name__}: {error}"
            self._tell()
            return
        self._ask(spec.Message.INFER, {spec.Payload.OBSERVATION: obs}, len(data))
        self._step += 1

    def _ask(self, kind: str, payload: dict[str, Any], size: int = 0) -> None:
        identity = str(self._next()) if kind == spec.Message.INFER else kind
        self._owner.asked(self, codec.Frame(kind, self._evaluation, payload, identity, step=self._step), size)

    def _next(self) -> int:
        self._asked += 1
        return self._asked

    @staticmethod
    def _is_greeted(frame: codec.Frame) -> bool:
        """Tell whether an answer is one to an observation, and not to what was said for the peer."""
        return frame.message_id.isdecimal()

    def _translated(self, frame: codec.Frame) -> bytes | str:
        if frame.message_type == spec.Message.ERROR:
            return _sentence(frame)
        try:
            rows = self._meaning.actions(frame.payload[spec.Payload.ACTIONS])
        except (ActionError, TypeError, ValueError, LookupError) as error:
            return f"the policy's answer is no action chunk of {self._meaning.embodiment.name}: {error}"
        latency = frame.payload.get(spec.Payload.LATENCY_MS)
        return openpi.pack({ACTIONS: rows, "server_timing": {"infer_ms": latency}})

    def _tell(self) -> None:
        """Send what is there in the order of the observations: nothing else says which answer is which."""
        while (answer := self._answers.pop(self._told + 1, None)) is not None:
            self._told += 1
            self._settle()
            self._send(answer)

    def _send(self, data: bytes | str) -> None:
        if not self.is_open or self._transport is None:
            return
        kind = WSMsgType.TEXT if isinstance(data, str) else WSMsgType.BINARY
        self._transport.send(kind, data.encode() if isinstance(data, str) else data)


def about(policy: Mapping[str, Any], meaning: Names) -> dict[str, Any]:
    """Return the metadata: what openpi's clients are told first."""
    return {
        **{key: value for key, value in policy.items() if value is not None},
        "action_order": list(meaning.embodiment.dims(meaning.action_type).items()),
        "observation": {name: target for name, target in meaning.names.items() if target is not None},
        "episode": "begins with the connection: this wire has no reset",
    }


def _sentence(frame: codec.Frame) -> str:
    return f"{frame.payload.get(spec.Payload.CODE)}: {frame.payload.get(spec.Payload.MESSAGE)}"
