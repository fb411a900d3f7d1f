"""Convert the payloads of clients that do not pack them into the form that a worker reads."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl import image_codec
from xpl.observation import ObservationError
from xpl.wire import packed
from xpl_cli.serving.requests import RequestError

if TYPE_CHECKING:
    from xpl.contract import Payload


def has_images(payload: Payload) -> bool:
    """Tell whether an observation in a payload has encoded images, which the server decodes for the adapter."""
    return any(image_codec.has_encoded(payload.get(name)) for name in (spec.Payload.OBSERVATION, spec.Payload.OBS))


def decode_images(payload: Payload) -> Payload:
    """Return a payload with its encoded images decoded. Slow: runs in a thread.

    Raises:
        RequestError: `invalid_frame` if one is damaged.
    """
    try:
        return {name: _decode_images(value) for name, value in payload.items()}
    except ObservationError as error:
        raise RequestError(spec.ErrorCode.INVALID_FRAME, str(error)) from None


def pack(payload: Payload) -> bytes:
    """Return a payload in the form that a worker reads.

    Raises:
        RequestError: `invalid_frame` if it holds a value that cannot be serialised.
    """
    # The sequence number concerns client and front end only; the adapter's hooks get all other entries.
    entries = {name: value for name, value in payload.items() if name != spec.Payload.SEQUENCE}
    try:
        return b"".join(packed.encode(entries))
    except packed.PackingError as error:
        raise RequestError(spec.ErrorCode.INVALID_FRAME, str(error)) from None


def _decode_images(value: Any) -> Any:
    return (
        [image_codec.decode_observation(item) for item in value]
        if isinstance(value, list)
        else image_codec.decode_observation(value)
    )
