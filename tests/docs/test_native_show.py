"""The picture on docs/native.md shows what `xpl native show` draws of three planted mistakes."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from tests.support.adapters import sights
from tests.support.places import ROOT
from xpl_cli.native.show import scene, seen, sheet
from xpl_cli.native.show.subject import subject
from xpl_cli.packages import package

if TYPE_CHECKING:
    from pathlib import Path

PICTURE = ROOT / "docs" / "assets" / "native-show.png"
WORDS = {"arm": "left", "point": "tcp", "frame": "base"}


def picture(folder: Path) -> Image.Image:
    """Return it; to renew the page's, save what this returns with `optimize`."""
    mirrored = [{"mirror": "left_right"}, {"resize": {"to": [64, 64], "filter": "area"}}]
    native = sights.block(
        images=[
            sights.image("top", "cam_head", channels="bgr"),
            sights.image("left_wrist", "cam_right_wrist"),
            sights.image("right_wrist", "cam_left_wrist", steps=mirrored),
        ]
    )
    pose = [{"position": WORDS}, {"rotation": {**WORDS, "form": "rot6d_columns"}}]
    native["state"].append({"input": "pose", "parts": pose})
    what = subject(package.load(sights.made(folder / "Planted", native)), {})
    found = seen.look(what, scene.scripted(what.package.manifest, what.robot, what.cameras, 1))
    with Image.open(io.BytesIO(sheet.sheet(replace(found, vectors=[], action=[], texts={})))) as opened:
        size = opened.width * 3 // 4, opened.height * 3 // 4
        return opened.convert("RGB").resize(size, Image.Resampling.LANCZOS).quantize(192)


def test_the_picture_is_what_is_drawn(tmp_path: Path) -> None:
    """Up to lettering and rounding, which differ from machine to machine; small enough for a page."""
    new = picture(tmp_path)
    with Image.open(PICTURE) as old:
        assert old.size == new.size
        difference = np.abs(np.asarray(old.convert("RGB")).astype(int) - np.asarray(new.convert("RGB")).astype(int))
    assert difference.mean() < 1
    assert PICTURE.stat().st_size < 200_000
