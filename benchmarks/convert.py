"""Conversion time of three 480 x 640 images to a model's 224 x 224, by `xpl.convert` and by others.

Each row is a filter; beside it the same filter of OpenCV and of Pillow, which adapters call by hand. Calls run
in turn (A B C A B C ...) in one process and one thread, so that a machine that changes its speed changes all of them
alike. The results are compared, too: another filter that is fast is no comparison.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from xpl.convert.images import ImageInput

VIEWS, SIZE, TO = 3, (480, 640), (224, 224)
FILTERS = ("bilinear", "bilinear antialias", "area", "bicubic antialias", "lanczos antialias")
_OPENCV = {"bilinear": cv2.INTER_LINEAR, "area": cv2.INTER_AREA}
_PILLOW = {
    "bilinear antialias": Image.Resampling.BILINEAR,
    "bicubic antialias": Image.Resampling.BICUBIC,
    "lanczos antialias": Image.Resampling.LANCZOS,
}

Convert = Callable[[list[np.ndarray]], np.ndarray]


@dataclass(frozen=True)
class Row:
    """What one way took for all views, ms; how much longer than ours; and how far apart the pixels are."""

    filter: str
    way: str
    median_ms: float
    min_ms: float
    max_ms: float
    ratio: float
    apart: int


def converters(name: str) -> dict[str, Convert]:
    """Return the ways to convert three views by one filter; ours first."""
    kind, _, antialias = name.partition(" ")
    step = {"resize": {"to": list(TO), "filter": kind, "antialias": bool(antialias)}}
    plain = {"channels": "rgb", "layout": "hwc", "dtype": "uint8"}
    ours = ImageInput({"input": "image", "cameras": ["cam_head"], "steps": [step], **plain})
    implementations: dict[str, Convert] = {"xpl.convert": lambda views: np.stack([ours.view(view) for view in views])}
    if name in _OPENCV:
        implementations["OpenCV"] = lambda views: np.stack(
            [cv2.resize(view, TO[::-1], interpolation=_OPENCV[name]) for view in views]
        )
    if name in _PILLOW:
        implementations["Pillow"] = lambda views: np.stack(
            [np.asarray(Image.fromarray(view).resize(TO[::-1], _PILLOW[name])) for view in views]
        )
    return implementations


def measure(runs: int) -> list[Row]:
    """Return a row for every filter and way."""
    rng = np.random.default_rng(0)
    views = [rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8) for _ in range(VIEWS)]
    rows = []
    for name in FILTERS:
        implementations = converters(name)
        made = {way: convert(views).astype(int) for way, convert in implementations.items()}
        took: dict[str, list[float]] = {way: [] for way in implementations}
        for _ in range(runs):
            for way, convert in implementations.items():
                begin = time.perf_counter()
                convert(views)
                took[way].append((time.perf_counter() - begin) * 1000)
        ours = statistics.median(took["xpl.convert"])
        for way, times in took.items():
            middle = statistics.median(times)
            apart = int(np.abs(made[way] - made["xpl.convert"]).max())
            rows.append(Row(name, way, middle, min(times), max(times), middle / ours, apart))
    return rows


def main() -> None:
    """Print a table; with --json, write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--json", type=Path, help="file that the figures are written to")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rows = measure(options.runs)
    print(f"{VIEWS} views {SIZE[0]}x{SIZE[1]} -> {TO[0]}x{TO[1]}, {options.runs} runs, one thread, ms")
    print(f"{'filter':20} {'way':12} {'median':>8} {'min':>8} {'max':>8} {'x ours':>7} {'apart':>6}")
    for row in rows:
        times = " ".join(f"{value:8.2f}" for value in (row.median_ms, row.min_ms, row.max_ms))
        print(f"{row.filter:20} {row.way:12} {times} {row.ratio:7.2f} {row.apart:6}")
    if options.json:
        figures: dict[str, Any] = {"runs": options.runs, "rows": [asdict(row) for row in rows]}
        options.json.write_text(f"{json.dumps(figures, indent=2)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
