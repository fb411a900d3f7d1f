from __future__ import annotations

import io
import zlib
from typing import Any

import numpy as np
import pytest
from PIL import Image

from xpl import _spec as spec
from xpl import image_codec
from xpl.observation import ObservationError, get_image

RED, BLUE = (255, 0, 0), (0, 0, 255)


def picture() -> np.ndarray:
    """Return a red left half and a blue right half, (32, 64, 3): even JPEG keeps the halves apart."""
    image = np.zeros((32, 64, 3), np.uint8)
    image[:, :32], image[:, 32:] = RED, BLUE
    return image


def jpeg(image: np.ndarray, **options: Any) -> bytes:
    target = io.BytesIO()
    Image.fromarray(image).save(target, "JPEG", quality=95, **options)
    return target.getvalue()


def legacy(image: np.ndarray) -> bytes:
    """Return what the field stores: RGB handed to an encoder that expects BGR."""
    return jpeg(np.ascontiguousarray(image[:, :, ::-1]))


def is_picture(image: np.ndarray) -> bool:
    assert image.dtype == np.uint8
    assert image.shape == (32, 64, 3)
    inner = np.abs(image.astype(int) - picture())[:, [*range(24), *range(40, 64)]]
    return bool(inner.max() < 30)


def with_segment(data: bytes, kind: int, content: bytes, before: bytes = b"") -> bytes:
    return data[:2] + before + bytes([0xFF, kind]) + (len(content) + 2).to_bytes(2, "big") + content + data[2:]


def test_a_marked_jpeg_is_true_rgb() -> None:
    data = image_codec.encode_jpeg(picture())
    assert image_codec.has_marker(data)
    assert is_picture(image_codec.decode(data))
    assert is_picture(np.array(Image.open(io.BytesIO(data))))


def test_a_legacy_jpeg_decodes_to_rgb() -> None:
    """Without the marker red and blue are exchanged in the file."""
    data = legacy(picture())
    assert not image_codec.has_marker(data)
    assert is_picture(image_codec.decode(data))
    assert not is_picture(np.array(Image.open(io.BytesIO(data))))


def test_the_marker_is_found_wherever_a_header_segment_may_be() -> None:
    plain = jpeg(picture())
    marked = with_segment(plain, 0xFE, spec.JPEG_MARKER)
    assert image_codec.has_marker(marked)
    assert image_codec.has_marker(with_segment(marked, 0xE1, b"\xff\xda" + b"Exif" * 100))
    assert image_codec.has_marker(with_segment(marked, 0xFE, b"made by someone"))
    assert image_codec.has_marker(with_segment(plain, 0xFE, spec.JPEG_MARKER, before=b"\xff\xff\xff"[:2]))
    assert image_codec.has_marker(with_segment(plain, 0xFE, spec.JPEG_MARKER, before=b"\xff\x01"))
    assert image_codec.has_marker(with_segment(plain, 0xFE, spec.JPEG_MARKER + b"\0\0"))
    assert image_codec.has_marker(jpeg(picture(), comment=spec.JPEG_MARKER, exif=b"Exif\0\0" + bytes(500)))


def test_the_marker_elsewhere_is_no_marker() -> None:
    plain = legacy(picture())
    assert not image_codec.has_marker(with_segment(plain, 0xE1, spec.JPEG_MARKER))
    assert not image_codec.has_marker(with_segment(plain, 0xFE, b"not " + spec.JPEG_MARKER))
    assert not image_codec.has_marker(plain + b"\xff\xfe\x00\x0a" + spec.JPEG_MARKER)


def test_png_has_no_legacy_form() -> None:
    assert np.array_equal(image_codec.decode(image_codec.encode_png(picture())), picture())


@pytest.mark.parametrize(
    "data", [image_codec.encode_jpeg(picture()), legacy(picture()), image_codec.encode_png(picture())]
)
def test_padding_and_containers_do_not_matter(data: bytes) -> None:
    """Datasets pad with NUL; the wire delivers bytes or one-dimensional uint8 arrays."""
    padded = data + bytes(77)
    for form in (padded, bytearray(padded), memoryview(padded), np.frombuffer(padded, np.uint8)):
        assert is_picture(image_codec.decode(form))


@pytest.mark.parametrize("data", [b"", b"\xff\xd8", b"no image", image_codec.encode_png(picture())[:60], bytes(100)])
def test_what_is_no_image_is_an_observation_error(data: bytes) -> None:
    with pytest.raises(ObservationError, match="do not decode as an image"):
        image_codec.decode(data)


def test_a_small_file_cannot_unpack_to_gigabytes() -> None:
    """The declared size is looked at before a pixel is decoded."""
    size = (8000).to_bytes(4, "big") * 2
    header = b"IHDR" + size + b"\x08\x02\0\0\0"
    png = b"\x89PNG\r\n\x1a\n" + (13).to_bytes(4, "big") + header + zlib.crc32(header).to_bytes(4, "big")
    with pytest.raises(ObservationError, match="64000000 pixels"):
        image_codec.decode(png + b"\0\0\0\0IDAT" + zlib.crc32(b"IDAT").to_bytes(4, "big"))


def test_formats_that_start_programs_are_not_read() -> None:
    eps = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n%%EndComments\nshowpage\n"
    with pytest.raises(ObservationError):
        image_codec.decode(eps)


@pytest.mark.parametrize("image", [np.zeros((2, 2)), np.zeros((2, 2, 3)), np.zeros((2, 2, 4), np.uint8)])
def test_only_rgb_is_encoded(image: np.ndarray) -> None:
    for encode in (image_codec.encode_jpeg, image_codec.encode_png):
        with pytest.raises(ObservationError, match=r"\(H, W, 3\) uint8"):
            encode(image)


@pytest.mark.parametrize("spelling", ["color", "colors", "rgb", "image", None])
@pytest.mark.parametrize("form", [bytes, lambda data: np.frombuffer(data, np.uint8)], ids=["bytes", "array"])
def test_an_observation_is_decoded_under_every_spelling(spelling: str | None, form: Any) -> None:
    encoded = form(image_codec.encode_png(picture()))
    depth = np.ones((2, 2), np.float32)
    camera: Any = encoded if spelling is None else {spelling: encoded, "depth": depth, "own": b"bytes"}
    obs: dict[str, Any] = {
        "vision": {"cam_head": camera, "cam_wrist": {"color": picture()}},
        "state": {},
        "extra": b"kept",
    }
    decoded = image_codec.decode_observation(obs)
    assert np.array_equal(get_image(decoded, "cam_head"), picture())
    assert np.array_equal(get_image(decoded, "cam_wrist"), picture())
    assert decoded["extra"] == b"kept"
    assert obs["vision"]["cam_head"] is camera
    if spelling is not None:
        assert decoded["vision"]["cam_head"]["depth"] is depth
        assert decoded["vision"]["cam_head"]["own"] == b"bytes"
        assert camera[spelling] is encoded


@pytest.mark.parametrize("value", [None, 3, "text", [1], {}, {"vision": None}, {"vision": {"cam_head": None}}])
def test_what_holds_no_image_passes_through(value: Any) -> None:
    assert image_codec.decode_observation(value) == value
