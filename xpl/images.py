"""Image codec of the serving layer and the data tools (extra `images`). An adapter never decodes.

JPEGs come in two byte formats: standard ones, stamped with a COM segment `XPL-RGB1`, and legacy ones without it, in
which red and blue are exchanged. Decoders return RGB for both. PNG and other formats have no legacy form.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any, Union

import numpy as np

from xpl import _spec as spec
from xpl.observation import ObservationError, color_of, is_encoded

Encoded = Union[bytes, bytearray, memoryview, np.ndarray]

_SOI, _SOS, _COM = b"\xff\xd8", 0xDA, 0xFE
_STANDALONE = frozenset((0x01, *range(0xD0, 0xD9)))
DEFAULT_QUALITY = 95

# Not all that Pillow knows: its EPS reader, for example, starts another program on what came over the wire.
_FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "TIFF", "PPM")
PIXELS = 1 << 25
"""Largest image that is decoded, a little over 8K video: a small file can unpack to gigabytes."""


def encode_jpeg(image: np.ndarray, quality: int = DEFAULT_QUALITY) -> bytes:
    """Return a standard JPEG, stamped with the marker, of an (H, W, 3) uint8 RGB image."""
    target = io.BytesIO()
    _pillow().fromarray(_rgb(image)).save(target, "JPEG", quality=quality, comment=spec.JPEG_MARKER)
    return target.getvalue()


def encode_png(image: np.ndarray) -> bytes:
    """Return a lossless true-RGB PNG of an (H, W, 3) uint8 RGB image."""
    target = io.BytesIO()
    _pillow().fromarray(_rgb(image)).save(target, "PNG", compress_level=1)
    return target.getvalue()


def decode(data: Encoded) -> np.ndarray:
    """Return the (H, W, 3) uint8 RGB image of an encoded one; trailing NUL padding is ignored.

    Raises:
        ObservationError: if the bytes are not an image, or one of more than `PIXELS` pixels.
    """
    raw = data.tobytes() if isinstance(data, (np.ndarray, memoryview)) else bytes(data)
    pillow = _pillow()
    try:
        with pillow.open(io.BytesIO(raw), formats=_FORMATS) as opened:
            pixels = opened.width * opened.height
            image = np.array(opened.convert("RGB")) if pixels <= PIXELS else None
    except Exception as error:  # noqa: BLE001 - Pillow's readers raise almost anything on damaged files
        raise ObservationError(f"{len(raw)} bytes do not decode as an image: {error}") from None
    if image is None:
        raise ObservationError(f"an encoded image has {pixels} pixels, more than {PIXELS}")
    legacy = raw.startswith(_SOI) and not has_marker(raw)
    return np.ascontiguousarray(image[:, :, ::-1]) if legacy else image


def has_marker(jpeg: bytes) -> bool:
    """Tell whether a JPEG carries the marker of the standard: walks its segments up to the start of scan."""
    position = len(_SOI)
    while position + 4 <= len(jpeg) and jpeg[position] == 0xFF:
        kind = jpeg[position + 1]
        if kind == 0xFF or kind in _STANDALONE:  # fill byte, or a segment without a length
            position += 1 if kind == 0xFF else 2
            continue
        length = int.from_bytes(jpeg[position + 2 : position + 4], "big")
        if kind == _COM and jpeg[position + 4 : position + 2 + length].rstrip(b"\0") == spec.JPEG_MARKER:
            return True
        if kind == _SOS or length < 2:
            return False
        position += 2 + length
    return False


def has_encoded(value: Any) -> bool:
    """Tell whether an observation, or one of a list of them, has encoded colour images."""
    if isinstance(value, list):
        return any(map(has_encoded, value))
    vision = value.get(spec.Obs.VISION) if isinstance(value, Mapping) else None
    return isinstance(vision, Mapping) and any(is_encoded(color_of(camera)) for camera in vision.values())


def decode_observation(obs: Any) -> Any:
    """Return the observation with every encoded colour image replaced by its RGB array; nothing is changed in place."""
    if not isinstance(obs, Mapping) or not isinstance(obs.get(spec.Obs.VISION), Mapping):
        return obs
    vision = {name: _decoded_camera(camera) for name, camera in obs[spec.Obs.VISION].items()}
    return {**obs, spec.Obs.VISION: vision}


def _decoded_camera(camera: Any) -> Any:
    color = color_of(camera)
    if not is_encoded(color):
        return camera
    image = decode(color)
    return {**camera, spec.Camera.COLOR: image} if isinstance(camera, Mapping) else image


def _rgb(image: np.ndarray) -> np.ndarray:
    array = np.asarray(image)
    if array.ndim != 3 or array.shape[2] != spec.COLOR_CHANNELS or array.dtype != np.uint8:
        raise ObservationError(f"an image must be (H, W, 3) uint8 RGB, got {array.shape} {array.dtype}")
    return array


def _pillow() -> Any:
    try:
        from PIL import Image
    except ImportError:
        raise ImportError("the image codec needs Pillow: install the extra `images`") from None
    return Image
