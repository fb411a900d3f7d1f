"""Pictures as models get them: geometry, colours, numbers, axes; each word seen on pixels that are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from PIL import Image

from xpl.convert import ConversionError
from xpl.convert.images import ImageInput

RED, GREEN, BLUE = (255, 0, 0), (0, 255, 0), (0, 0, 255)
CORNERS = np.array([[RED, GREEN], [BLUE, (9, 9, 9)]], np.uint8)
"""Red at the upper left, green at the upper right, blue at the lower left."""


def _input(*steps: dict[str, Any], cameras: tuple[str, ...] = ("cam_head",), **more: Any) -> ImageInput:
    plain = {"channels": "rgb", "layout": "hwc", "dtype": "uint8"}
    return ImageInput({"input": "image", "cameras": list(cameras), "steps": list(steps), **plain, **more})


def _obs(**images: np.ndarray) -> dict[str, Any]:
    return {"vision": {name: {"color": image} for name, image in images.items()}}


@pytest.mark.parametrize(
    ("step", "upper_left"),
    [
        ({"rotate": 90}, GREEN),
        ({"rotate": 180}, (9, 9, 9)),
        ({"rotate": 270}, BLUE),
        ({"mirror": "left_right"}, GREEN),
        ({"mirror": "up_down"}, BLUE),
    ],
)
def test_turned_and_mirrored(step: dict[str, Any], upper_left: tuple[int, int, int]) -> None:
    assert tuple(_input(step).view(CORNERS)[0, 0]) == upper_left


def test_colours_and_axes() -> None:
    assert _input(channels="bgr").view(CORNERS)[0, 0].tolist() == [0, 0, 255]
    assert _input(layout="chw").view(CORNERS)[0].tolist() == [[255, 0], [0, 9]]
    assert _input(channels="bgr", layout="chw").view(CORNERS)[2].tolist() == [[255, 0], [0, 9]]


def test_numbers() -> None:
    assert _input(dtype="float32").view(CORNERS)[0, 0].tolist() == [1, 0, 0]
    assert _input(dtype="float32", range=[-1, 1]).view(CORNERS)[0, 0].tolist() == [1, -1, -1]
    assert _input(dtype="float32", range=[0, 255]).view(CORNERS)[1, 1].tolist() == [9, 9, 9]
    seen = _input(dtype="float32", channels="bgr", mean=[0.1, 0.2, 0.4], std=[0.5, 0.5, 0.2]).view(CORNERS)
    assert seen[0, 0] == pytest.approx([-0.2, -0.4, 3.0], abs=1e-6)
    assert seen.dtype == np.float32


def test_numbers_are_the_quotient_that_the_field_computes() -> None:
    """LeRobot and openpi divide by 255; a product with 1 / 255 differs in the last digit of every second byte."""
    every = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=2)
    quotient = every.astype(np.float32) / np.float32(255)
    assert np.array_equal(_input(dtype="float32", range=[0, 1]).view(every), quotient)
    assert np.array_equal(_input(dtype="float32", range=[-1, 1]).view(every), quotient * 2 - 1)


def test_stacks() -> None:
    obs = _obs(cam_head=CORNERS, cam_left_wrist=CORNERS[::-1])
    both = ("cam_head", "cam_left_wrist")
    assert _input(cameras=both, stack="views").encode(obs).shape == (2, 2, 2, 3)
    wide = _input(cameras=both, stack="width").encode(obs)
    assert [tuple(pixel) for pixel in wide[0]] == [RED, GREEN, BLUE, (9, 9, 9)]
    deep = _input(cameras=both, stack="channels").encode(obs)
    assert deep[0, 0].tolist() == [255, 0, 0, 0, 0, 255]
    first = _input(cameras=both, stack="channels", layout="chw").encode(obs)
    assert first.shape == (6, 2, 2)
    assert _input(cameras=both, stack="width", layout="chw").encode(obs).shape == (3, 2, 4)


@pytest.mark.parametrize(
    ("size", "to", "box"),
    [
        ((480, 640), (224, 224), (28, 0, 168, 224)),
        ((100, 165), (224, 224), (44, 0, 135, 223)),  # 165 / (165 / 224) is 223.99..., and the authors cut it off
        ((100, 191), (224, 224), (53, 0, 117, 224)),  # times the inverse it would be 223
        ((640, 480), (224, 224), (0, 28, 224, 168)),
        ((7, 10), (16, 15), (3, 0, 10, 15)),  # of a rest of 6 three are above
        ((7, 10), (16, 16), (2, 0, 11, 16)),  # of a rest of 5 two are above
    ],
)
def test_a_letterbox_is_as_its_authors_wrote_it(
    size: tuple[int, int], to: tuple[int, int], box: tuple[int, ...]
) -> None:
    top, left, rows, columns = box
    white = np.full((*size, 3), 255, np.uint8)
    frame = _input({"letterbox": {"to": list(to), "filter": "bilinear", "fill": 7}}).view(white)
    found = np.argwhere(frame[..., 0] == 255)
    assert found.min(0).tolist() == [top, left]
    assert (found.max(0) - found.min(0) + 1).tolist() == [rows, columns]
    assert set(np.unique(frame)) <= {7, 255}
    ratio = max(size[1] / to[1], size[0] / to[0])
    assert (rows, columns) == (int(size[0] / ratio), int(size[1] / ratio))


@pytest.mark.parametrize(("anchor", "first"), [("center", 1), ("bottom_right", 2), ("top_left", 0)])
def test_where_a_letterbox_has_its_rest(anchor: str, first: int) -> None:
    """It is centred by openpi, while SmolVLA fills above and at the left."""
    how = {"to": [4, 4], "filter": "nearest", "anchor": anchor}
    frame = _input({"letterbox": how}).view(np.full((2, 4, 3), 200, np.uint8))
    assert np.flatnonzero(frame[:, 0, 0]).tolist() == [first, first + 1]


def test_openpis_client_gives_the_same_picture() -> None:
    """Pillow's bilinear filter in a centred frame, written as there."""
    image = np.random.default_rng(4).integers(0, 256, (60, 97, 3), dtype=np.uint8)
    ratio = max(97 / 32, 60 / 32)
    height, width = int(60 / ratio), int(97 / ratio)
    wanted = Image.new("RGB", (32, 32), 0)
    small = Image.fromarray(image).resize((width, height), resample=Image.Resampling.BILINEAR)
    wanted.paste(small, (max(0, int((32 - width) / 2)), max(0, int((32 - height) / 2))))
    found = _input({"letterbox": {"to": [32, 32], "filter": "bilinear", "antialias": True}}).view(image)
    assert np.abs(found.astype(int) - np.asarray(wanted)).max() <= 1


@pytest.mark.parametrize(
    ("how", "rows", "columns"),
    [
        ({"to": [3, 4]}, (1, 4), (2, 6)),  # (6 - 3) // 2, (8 - 4) // 2
        ({"to": [6, 8]}, (0, 6), (0, 8)),
        ({"fraction": 0.75}, (1, 5), (1, 7)),  # int(4.5) rows, int(6) columns
    ],
)
def test_crops(how: dict[str, Any], rows: tuple[int, int], columns: tuple[int, int]) -> None:
    image = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)
    assert (_input({"crop": how}).view(image) == image[slice(*rows), slice(*columns)]).all()


def test_steps_are_done_in_their_order() -> None:
    image = np.random.default_rng(1).integers(0, 256, (16, 16, 3), dtype=np.uint8)
    crop, shrink = {"crop": {"to": [8, 8]}}, {"resize": {"to": [8, 8], "filter": "area"}}
    assert (_input(crop, shrink).view(image) == image[4:12, 4:12]).all()
    assert not (_input(shrink, crop).view(image) == image[4:12, 4:12]).all()


def test_numbers_that_are_not_rounded() -> None:
    """On floats a mean of 11 and 12 is 11.5; on bytes it is 12."""
    image = np.array([[[11] * 3, [12] * 3]], np.uint8)
    resize = {"to": [1, 1], "filter": "area"}
    assert _input({"resize": {**resize, "as": "float"}}, dtype="float32", range=[0, 255]).view(image)[0, 0, 0] == 11.5
    assert _input({"resize": {**resize, "as": "uint8"}}, dtype="float32", range=[0, 255]).view(image)[0, 0, 0] == 12
    assert _input({"resize": {**resize, "as": "float"}}).view(image)[0, 0, 0] == 12


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"cameras": ("cam_head", "cam_left_wrist")}, "model_io.images image: has 2 cameras in one input; set stack"),
        ({"range": [0, 1]}, "model_io.images image: bytes have neither range"),
        ({"dtype": "float32", "range": [1, 1]}, "model_io.images image: range is 1 at both ends"),
        ({"dtype": "float32", "std": [1, 0, 1]}, "model_io.images image: std holds a zero"),
    ],
)
def test_a_block_that_means_nothing_is_refused(more: dict[str, Any], told: str) -> None:
    with pytest.raises(ConversionError, match=told):
        _input(**more)


@pytest.mark.parametrize(
    ("step", "told"),
    [
        ({"crop": {"to": [3, 1]}}, "model_io.images image, cam_head: a crop to 3x1 of an image of 2x2; crop less"),
        ({"crop": {"fraction": 0.3}}, "a crop leaves nothing of an image of 2x2"),
        ({"letterbox": {"to": [1, 1], "filter": "area"}}, None),
    ],
)
def test_a_step_that_does_not_fit_the_picture(step: dict[str, Any], told: str | None) -> None:
    made = _input(step)
    if told is None:
        assert made.encode(_obs(cam_head=CORNERS)).shape == (1, 1, 3)
        return
    with pytest.raises(ConversionError, match=told):
        made.encode(_obs(cam_head=CORNERS))


def test_views_of_different_sizes_are_no_input() -> None:
    obs = _obs(cam_head=CORNERS, cam_left_wrist=CORNERS[:1])
    with pytest.raises(ConversionError, match=r"model_io.images image: views of one input have one size"):
        _input(cameras=("cam_head", "cam_left_wrist"), stack="views").encode(obs)
