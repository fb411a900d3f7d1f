"""Decoding and encoding of the images stored in datasets.

Channels are not swapped: a JPEG's pixels are what the JPEG standard says. Some datasets hold JPEGs whose red and blue
were swapped when they were written; that is a convention, which a mapping states and the probe measures.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Final

import numpy as np
from PIL import Image

from xpl import image_codec
from xpl.observation import ObservationError
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from numpy.typing import NDArray

_JPEG: Final = b"\xff\xd8\xff"


def decode_image(data: bytes, where: str) -> NDArray[np.uint8]:
    """Decode an image to (H, W, 3) uint8 in the file's own channel order.

    Raises:
        DataError: the image cannot be decoded.
    """
    try:
        image: NDArray[np.uint8] = image_codec.decode(data)
    except ObservationError as error:
        raise DataError(f"{where}: {error}") from None
    is_exchanged = data.startswith(_JPEG) and not image_codec.has_marker(data)
    return np.ascontiguousarray(image[:, :, ::-1]) if is_exchanged else image


def encode_image(image: NDArray[np.uint8], encoding: str) -> bytes:
    """Encode an image (H, W, 3) uint8; `decode_image` is the inverse.

    Args:
        image: the pixels.
        encoding: png or jpeg.
    """
    target = io.BytesIO()
    picture = Image.fromarray(np.ascontiguousarray(image))
    if encoding == "png":
        picture.save(target, "PNG", compress_level=1)
    else:
        picture.save(target, "JPEG", quality=image_codec.DEFAULT_QUALITY)
    return target.getvalue()


def thumbnail(image: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """Downscale an image to at most `width` pixels wide and `4 * width` high."""
    share = min(1.0, width / image.shape[1], 4 * width / image.shape[0])
    if share == 1.0:
        return np.ascontiguousarray(image)
    wide, high = (max(1, round(size * share)) for size in image.shape[1::-1])
    return np.asarray(Image.fromarray(np.ascontiguousarray(image)).resize((wide, high), Image.Resampling.BILINEAR))


def psnr(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> float:
    """Return the peak signal-to-noise ratio of two images, dB; infinite where they are the same."""
    total = sum(float(np.square(a.astype(np.float32) - b).sum()) for a, b in zip(one, other, strict=True))  # row by row
    error = total / one.size
    return float("inf") if error == 0 else 10 * float(np.log10(255.0**2 / error))
