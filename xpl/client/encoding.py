"""How a client puts requests into bytes: packed where the server takes that, in shared memory where both see it.

Colour of chosen cameras can travel as JPEG; then the request is not packed, because the server has to decode it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Callable

from xpl import _spec as spec
from xpl import images
from xpl.observation import color_of, is_encoded
from xpl.wire import codec, packed

if TYPE_CHECKING:
    from xpl.contract import Observation, Payload
    from xpl.wire.segment import Arena

_PACKABLE = (spec.Message.INFER, spec.Message.CALL)


class Encoder:
    """Puts requests into bytes.

    Args:
        packed: pack payloads where the server takes that.
        jpeg: quality (1..100) of the cameras whose colour is sent as JPEG.

    Attributes:
        capabilities: what the server announced.
    """

    def __init__(self, *, packed: bool, jpeg: Mapping[str, int]) -> None:
        self._packs = packed
        self._jpeg = jpeg
        self._arena: Arena | None = None
        self.capabilities: Mapping[str, Any] = {}

    def share(self, offer: Mapping[str, Any]) -> str | None:
        """Open the memory that a server offers; return the proof that we see it, or None if we do not."""
        try:
            from xpl.wire.segment import Arena

            self._arena = Arena(str(offer["path"]), int(offer["size"]))
        except (ImportError, OSError, LookupError, TypeError, ValueError):
            return None  # another machine, another user, another system: arrays travel in the message
        return self._arena.token.hex()

    def confirm(self, proof: object) -> None:
        """Use the memory if the server read there what we wrote; let go of it otherwise."""
        if self._arena is not None and proof != self._arena.answer.hex():
            self.forget()

    def forget(self) -> None:
        """Let go of the memory that was shared over a connection."""
        arena, self._arena = self._arena, None
        if arena is not None:
            arena.close()

    def encode(self, frame: codec.Frame) -> tuple[bytes, list[int]]:
        """Return the bytes of a request, and what it uses of the shared memory until it is `answered`.

        Raises:
            WireError: if its payload cannot travel.
        """
        payload = frame.payload
        key = spec.Payload.OBSERVATION if spec.Payload.OBSERVATION in payload else spec.Payload.OBS
        value = payload.get(key)
        if value is None or frame.message_type not in _PACKABLE:
            return codec.encode(frame), []
        if self._jpeg and self.capabilities.get(spec.Capability.JPEG_MARKER):
            value = _each(value, self._compressed)
        packs = self._packs and bool(self.capabilities.get(spec.Capability.PACKED))
        if not packs or images.has_encoded(value):
            return codec.encode(_with(frame, {**payload, key: value})), []
        pieces, blocks = self._pieces({key: value}, frame.message_type)
        if len(pieces[0]) > spec.LIMITS["packed_header"]:
            self.answered(blocks)
            return codec.encode(frame), []
        rest = {name: item for name, item in payload.items() if name != key}
        return codec.encode(_with(frame, rest), pieces), blocks

    def answered(self, blocks: list[int]) -> None:
        """Free what a request used, unless the worker has taken it."""
        if blocks and self._arena is not None:
            self._arena.answered(blocks)

    def _pieces(self, entries: Mapping[str, Any], message_type: str) -> tuple[Sequence[Any], list[int]]:
        if self._arena is None:
            return _packed(entries, message_type, None), []
        try:
            return _packed(entries, message_type, self._arena.place), self._arena.written()
        except codec.WireError:
            self._arena.answered(self._arena.written())
            raise

    def _compressed(self, obs: Observation) -> Mapping[str, Any]:
        """Return an observation with the colour of the chosen cameras as marked JPEG."""
        vision = obs.get(spec.Obs.VISION)
        if not isinstance(vision, Mapping):
            return obs
        smaller = dict(vision)
        for name, quality in self._jpeg.items():
            color = color_of(vision[name]) if name in vision else None
            if color is not None and not is_encoded(color):
                jpeg = images.encode_jpeg(color, quality)
                camera = vision[name]
                smaller[name] = {**camera, spec.Camera.COLOR: jpeg} if isinstance(camera, Mapping) else jpeg
        return {**obs, spec.Obs.VISION: smaller}


def _packed(entries: Mapping[str, Any], message_type: str, place: packed.Place | None) -> Sequence[Any]:
    try:
        return packed.encode(entries, place)
    except packed.PackingError as error:
        raise codec.WireError(f"the {message_type} payload cannot be sent: {error}") from None


def _with(frame: codec.Frame, payload: Payload) -> codec.Frame:
    """Return the same request with another payload."""
    return codec.Frame(**{**vars(frame), spec.Frame.PAYLOAD: payload})


def _each(value: object, change: Callable[[Mapping[str, Any]], Any]) -> Any:
    """Return an observation, or each of a list of them, changed; anything else stays as it is."""
    if isinstance(value, list):
        return [_each(item, change) for item in value]
    return change(value) if isinstance(value, Mapping) else value
