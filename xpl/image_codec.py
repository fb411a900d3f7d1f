"""Image codec of the serving layer and the data tools (extra `images`). Adapters get decoded images.

There are two kinds of JPEG: standard ones, marked by a COM segment `XPL-RGB1`, and legacy ones without it, in which red
and blue are exchanged. Decoders return RGB for both. PNG and other formats have no legacy form.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from typing import Any, Callable, Union

import numpy as np

from xpl import _spec as spec
from xpl.observation import ObservationError, color_of, is_encoded

Encoded = Union[bytes, bytearray, memoryview, np.ndarray]

_SOI, _SOS, _COM = b"\xff\xd8", 0xDA, 0xFE
_STANDALONE = frozenset((0x01, *range(0xD0, 0xD9)))
DEFAULT_QUALITY = 95

# Not all formats of Pillow: its EPS reader, for example, starts another program on untrusted input.
_FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "TIFF", "PPM")
PIXELS = 1 << 25
"""Largest image that is decoded, a little over 8K video: a small file can unpack to gigabytes."""
_SCANS = 128
"""Most passes over a progressive JPEG; encoders make about ten, and each takes as long as the whole image."""
_SCANNED = 12 * PIXELS
"""Most pixels of all passes over one."""
_SEGMENTS = 1 << 16
"""Most parts of a file, fill bytes included: Pillow walks them in Python, a file of nothing else would take minutes."""
_PNG = b"\x89PNG\r\n\x1a\n"
_FRAMES = frozenset((*range(0xC0, 0xC4), *range(0xC5, 0xC8), *range(0xC9, 0xCC), *range(0xCD, 0xD0)))
"""JPEG markers that begin a frame, SOF0 to SOF15 (ITU-T T.81, table B.1)."""


def encode_jpeg(image: np.ndarray, quality: int = DEFAULT_QUALITY) -> bytes:
    """Return a standard JPEG, with the marker, of an (H, W, 3) uint8 RGB image."""
    target = io.BytesIO()
    _pillow().fromarray(_rgb(image)).save(target, "JPEG", quality=quality, comment=spec.JPEG_MARKER)
    return target.getvalue()


def encode_png(image: np.ndarray) -> bytes:
    """Return a lossless true-RGB PNG of an (H, W, 3) uint8 RGB image."""
    target = io.BytesIO()
    _pillow().fromarray(_rgb(image)).save(target, "PNG", compress_level=1)
    return target.getvalue()


def size_of(data: Encoded) -> tuple[int, int]:
    """Return (width, height) of an encoded image from its header, without decoding.

    Raises:
        ObservationError: the bytes are no image, or one of more than `PIXELS` pixels.
    """
    raw = _raw(data)
    reader = next((reader for begins, reader in _READERS if raw.startswith(begins)), None)
    size = None if reader is None else reader(raw)
    if reader is not None and size is None:
        raise ObservationError(f"{len(raw)} bytes do not decode as an image: its header is damaged, or not read here")
    if size is None:
        try:
            with _pillow().open(io.BytesIO(raw), formats=_FORMATS) as opened:
                size = opened.size
        except ImportError:
            raise
        except Exception as error:  # noqa: BLE001 - Pillow's readers raise almost anything on damaged files
            raise ObservationError(f"{len(raw)} bytes do not decode as an image: {error!s:.200}") from None
    if size[0] * size[1] > PIXELS:
        raise ObservationError(f"an encoded image has {size[0] * size[1]} pixels, more than {PIXELS}")
    return size


def decode(data: Encoded) -> np.ndarray:
    """Return the (H, W, 3) uint8 RGB image of an encoded one; trailing NUL padding is ignored.

    Raises:
        ObservationError: the bytes are no image, or one of more than `PIXELS` pixels.
    """
    raw = _raw(data)
    size = size_of(raw)
    scans = raw.count(b"\xff\xda") if raw.startswith(_SOI) else 1
    if scans > _SCANS or scans * size[0] * size[1] > _SCANNED:
        raise ObservationError(
            f"an encoded image of {size[0]} x {size[1]} pixels has {scans} passes, more than are read"
        )
    try:
        with _pillow().open(io.BytesIO(raw), formats=_FORMATS) as opened:
            image = _pixels(opened, size)
    except ImportError:
        raise
    except Exception as error:  # noqa: BLE001 - as above
        raise ObservationError(f"{len(raw)} bytes do not decode as an image: {error!s:.200}") from None
    legacy = raw.startswith(_SOI) and not has_marker(raw)
    return np.ascontiguousarray(image[:, :, ::-1]) if legacy else image


def has_marker(jpeg: bytes) -> bool:
    """Return whether a JPEG has the marker of the standard, in a segment before the start of scan."""
    return any(kind == _COM and segment.rstrip(b"\0") == spec.JPEG_MARKER for kind, segment in _segments(jpeg))


def _segments(jpeg: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield kind and content of the segments of a JPEG up to the start of scan; nothing of what is no JPEG."""
    position = len(_SOI) if jpeg.startswith(_SOI) else len(jpeg)
    for _ in range(_SEGMENTS):
        if position + 4 > len(jpeg) or jpeg[position] != 0xFF:
            return
        kind = jpeg[position + 1]
        if kind == 0xFF or kind in _STANDALONE:  # fill byte, or a segment without a length
            position += 1 if kind == 0xFF else 2
            continue
        length = int.from_bytes(jpeg[position + 2 : position + 4], "big")
        if kind == _SOS:
            yield kind, b""
        if kind == _SOS or length < 2:
            return
        yield kind, jpeg[position + 4 : position + 2 + length]
        position += 2 + length


def pixels_of(value: object) -> int:
    """Return the number of pixels of all encoded colour images of an observation, or of a list of them.

    Raises:
        ObservationError: one is no image, or too large.
    """
    if isinstance(value, list):
        return sum(map(pixels_of, value))
    vision = value.get(spec.Obs.VISION) if isinstance(value, Mapping) else None
    colors = [color_of(camera) for camera in vision.values()] if isinstance(vision, Mapping) else []
    sizes = [size_of(color) for color in colors if is_encoded(color)]
    return sum(width * height for width, height in sizes)


def has_encoded(value: object) -> bool:
    """Return whether an observation, or one of a list of them, has encoded colour images."""
    if isinstance(value, list):
        return any(map(has_encoded, value))
    vision = value.get(spec.Obs.VISION) if isinstance(value, Mapping) else None
    return isinstance(vision, Mapping) and any(is_encoded(color_of(camera)) for camera in vision.values())


def decode_observation(obs: object) -> Any:
    """Return a copy of the observation with every encoded colour image replaced by its RGB array."""
    if not isinstance(obs, Mapping) or not isinstance(obs.get(spec.Obs.VISION), Mapping):
        return obs
    vision = {name: _decoded_camera(camera) for name, camera in obs[spec.Obs.VISION].items()}
    return {**obs, spec.Obs.VISION: vision}


def _decoded_camera(camera: object) -> Any:
    color = color_of(camera)
    if not is_encoded(color):
        return camera
    image = decode(color)
    return {**camera, spec.Camera.COLOR: image} if isinstance(camera, Mapping) else image


def _pixels(opened: Any, size: tuple[int, int]) -> np.ndarray:
    """Return the pixels of a file that Pillow has opened, RGB."""
    if opened.size != size:
        raise ValueError(f"one header says {size}, and a later one {opened.size}")
    return np.array(opened if opened.mode == "RGB" else opened.convert("RGB"))


def _raw(data: Encoded) -> bytes:
    return data.tobytes() if isinstance(data, (np.ndarray, memoryview)) else bytes(data)


def _png_size(raw: bytes) -> tuple[int, int] | None:
    """Return width and height in the header of a PNG, None if it has none (ISO/IEC 15948, 11.2.2)."""
    if raw[12:16] != b"IHDR" or len(raw) < 24:
        return None
    position = len(_PNG)
    for _ in range(_SEGMENTS):
        position += 12 + int.from_bytes(raw[position : position + 4], "big")
        if position >= len(raw):
            break
    else:
        return None
    return int.from_bytes(raw[16:20], "big"), int.from_bytes(raw[20:24], "big")


def _jpeg_size(raw: bytes) -> tuple[int, int] | None:
    """Return width and height in the frame header of a JPEG, None if it has none (ITU-T T.81, B.2.2)."""
    size = None
    for kind, segment in _segments(raw):
        if kind in _FRAMES and len(segment) >= 5:
            size = int.from_bytes(segment[3:5], "big"), int.from_bytes(segment[1:3], "big")
        if kind == _SOS:
            return size
    return None


def _webp_size(raw: bytes) -> tuple[int, int] | None:
    """Return width and height of a WebP, None if it has no header (RFC 9649, section 2)."""
    if raw[8:12] != b"WEBP" or len(raw) < 30:
        return None
    kind, body = raw[12:16], raw[20:30]
    if kind == b"VP8X":
        return 1 + int.from_bytes(body[4:7], "little"), 1 + int.from_bytes(body[7:10], "little")
    if kind == b"VP8L":
        bits = int.from_bytes(body[1:5], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    if kind == b"VP8 ":
        return int.from_bytes(body[6:8], "little") & 0x3FFF, int.from_bytes(body[8:10], "little") & 0x3FFF
    return None


def _bmp_size(raw: bytes) -> tuple[int, int] | None:
    """Return width and height of a BMP; None for one with runs, which Pillow reads in Python."""
    if raw[30:34] not in (bytes(4), b"\x03\0\0\0") or raw[14:18] == b"\x0c\0\0\0":
        return None
    width, height = (int.from_bytes(raw[place : place + 4], "little", signed=True) for place in (18, 22))
    return width, abs(height)


_READERS: tuple[tuple[bytes, Callable[[bytes], tuple[int, int] | None]], ...] = (
    (_PNG, _png_size),
    (_SOI, _jpeg_size),
    (b"RIFF", _webp_size),
    (b"BM", _bmp_size),
    *((begins, lambda _: None) for begins in (b"P1", b"P2", b"P3")),  # numbers as text, which Pillow reads in Python
)
"""How files begin, and what reads their size."""


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
