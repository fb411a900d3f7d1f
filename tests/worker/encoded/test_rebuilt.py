"""Encoded pictures are made again by another geometry."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from xpl.catalogue.walk import NoEffectError
from xpl.convert.images import ImageInput
from xpl.image_resize import resize
from xpl.worker.encoded.rebuilt import RebuiltImages

RNG = np.random.default_rng(3)
CAMERAS = ("cam_head", "cam_wrist")
OBS = {"vision": {name: {"color": RNG.integers(0, 256, (48, 64, 3)).astype(np.uint8)} for name in CAMERAS}}
STEPS = [{"resize": {"filter": "bilinear", "antialias": True}}]
SIZE = (20, 24)


def _image(obs: Any, camera: str) -> np.ndarray:
    return np.asarray(obs["vision"][camera]["color"])


def _right(camera: str, size: tuple[int, int] = SIZE) -> np.ndarray:
    steps = [{"resize": {"filter": "bilinear", "antialias": True, "to": list(size)}}]
    entry = {"input": "", "channels": "rgb", "layout": "hwc", "dtype": "uint8", "cameras": [camera]}
    return np.asarray(ImageInput({**entry, "steps": steps}).view(_image(OBS, camera)))


def _cut(obs: Any, camera: str) -> np.ndarray:
    return np.asarray(resize(_image(obs, camera)[:40, 4:44], SIZE, "nearest"))


def test_numbers_colours_and_orientation_stay() -> None:
    def encode(obs: Any) -> Any:
        head = _cut(obs, "cam_head")[..., ::-1].astype(np.float32) / 127.5 - 1
        wrist = _cut(obs, "cam_wrist")[::-1].transpose(2, 0, 1).astype(np.float32) / 255
        return {"head": head, "more": [wrist, np.ones(5)]}

    result = RebuiltImages(encode, OBS)(encode(OBS), OBS, STEPS)
    assert np.allclose(result["head"], _right("cam_head")[..., ::-1] / 127.5 - 1, atol=1e-6)
    assert np.allclose(result["more"][0], _right("cam_wrist")[::-1].transpose(2, 0, 1) / 255, atol=1e-6)
    assert result["head"].dtype == np.float32
    assert result["more"][1].tolist() == [1.0] * 5


def test_two_in_one_and_bytes() -> None:
    def encode(obs: Any) -> Any:
        return np.hstack([_cut(obs, camera)[::-1, ::-1] for camera in CAMERAS[::-1]])

    wanted = np.hstack([_right(camera)[::-1, ::-1] for camera in CAMERAS[::-1]])
    result = RebuiltImages(encode, OBS)(encode(OBS), OBS, STEPS)
    assert np.array_equal(result, wanted)
    with pytest.raises(NoEffectError, match="several pictures"):
        RebuiltImages(encode, OBS)(encode(OBS), OBS, STEPS, exchanged=True)


def test_height_and_width_exchanged() -> None:
    def encode(obs: Any) -> Any:
        return np.stack([_cut(obs, camera).transpose(2, 0, 1) for camera in CAMERAS])

    result = RebuiltImages(encode, OBS)(encode(OBS), OBS, STEPS, exchanged=True)
    assert np.array_equal(result, np.stack([_right(one, SIZE[::-1]).transpose(2, 0, 1) for one in CAMERAS]))


def test_what_sees_nothing_is_left() -> None:
    for made in (np.ones(7), np.ones((*SIZE, 3))):
        with pytest.raises(NoEffectError):
            RebuiltImages(lambda _obs, made=made: made, OBS)
