"""Payloads of clients that do not pack: made into what a worker reads, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xpl import _spec as spec
from xpl import images, packed
from xpl.observation import ObservationError, color_of, is_encoded
from xpl_cli.serving.session import RequestError


def has_images(payload: Mapping[str, Any]) -> bool:
    """Tell whether an observation in a payload has encoded images: an adapter never decodes."""
    return any(
        is_encoded(color_of(camera))
        for observation in _observations(payload)
        if isinstance(vision := observation.get(spec.Obs.VISION), Mapping)
        for camera in vision.values()
    )


def without_images(payload: dict[str, Any]) -> dict[str, Any]:
    """Return a payload with its encoded images decoded. Slow: runs in a thread.

    Raises:
        RequestError: `invalid_frame` if one is damaged.
    """
    try:
        return {name: _decoded(value) for name, value in payload.items()}
    except ObservationError as error:
        raise RequestError(spec.ErrorCode.INVALID_FRAME, str(error)) from None


def pack(payload: Mapping[str, Any]) -> bytes:
    """Return a payload in the form that a worker reads.

    Raises:
        RequestError: `invalid_frame` if it holds what cannot travel.
    """
    # The number is between client and front end: the hooks of an adapter get all other entries.
    entries = {name: value for name, value in payload.items() if name != spec.Payload.SEQUENCE}
    try:
        return b"".join(packed.encode(entries))
    except packed.PackingError as error:
        raise RequestError(spec.ErrorCode.INVALID_FRAME, str(error)) from None


def answer_payload(result: memoryview) -> dict[str, Any]:
    """Return the entries of an answer that a worker packed."""
    entries: dict[str, Any] = packed.decode(result)
    return entries


def _observations(payload: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    shown = payload.get(spec.Payload.OBS)
    found = [payload.get(spec.Payload.OBSERVATION), *(shown if isinstance(shown, list) else [shown])]
    return [item for item in found if isinstance(item, Mapping)]


def _decoded(value: Any) -> Any:
    return (
        [images.decode_observation(item) for item in value]
        if isinstance(value, list)
        else images.decode_observation(value)
    )
