"""How long conversions of demonstrations take, by `xpl data convert` and by LeRobot's own means, in one run.

The task is robomimic's HDF5 to LeRobot v3.0, which LeRobot's recorder does frame by frame, as scripts of the field use
it. Both encode AV1 with the same quality. Rounds alternate, so that a machine that changes its speed changes both
alike. Ours is the whole process; LeRobot's is without its imports.

`XPL_LEROBOT_PYTHON` names a Python that has LeRobot 0.4 and h5py.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import h5py
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
DRIVER = ROOT / "tests" / "data" / "conversion" / "lerobot_driver.py"
CAMERAS = ("agentview_rgb", "eye_in_hand_rgb")


@dataclass(frozen=True)
class Row:
    """What one way took, s; steps that it converted in a second; and MB that it wrote."""

    task: str
    way: str
    median_s: float
    min_s: float
    max_s: float
    steps_per_s: float
    size_mb: float


def make(path: Path, episodes: int, steps: int, size: int) -> None:
    """Write a set with smooth pictures that move, and a little noise."""
    draw = np.random.default_rng(0)
    rows, columns = np.mgrid[0:size, 0:size]
    with h5py.File(path, "w") as file:
        for index in range(episodes):
            group = file.create_group(f"data/demo_{index}")
            group["actions"] = draw.normal(size=(steps, 7))
            group["obs/joint_states"] = draw.normal(size=(steps, 7))
            for camera in CAMERAS:
                images = np.empty((steps, size, size, 3), np.uint8)
                for step in range(steps):
                    wave = 127 + 100 * np.sin((rows + 3 * step) / 17)
                    smooth = np.stack([wave, (columns + 2 * step) % 256, 255 - wave], -1)
                    images[step] = np.clip(smooth + draw.normal(0, 2, smooth.shape), 0, 255)
                group.create_dataset(f"obs/{camera}", data=images, chunks=(1, size, size, 3))


def ours(source: Path, target: Path) -> float:
    """Convert by `xpl data convert`; return seconds."""
    command = [sys.executable, "-m", "xpl_cli", "data", "convert", str(source), str(target)]
    command += ["--to", "lerobot-v3.0", "--rate", "20"]
    begins = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)})
    return time.perf_counter() - begins


def theirs(python: str, source: Path, target: Path) -> float:
    """Let LeRobot's recorder do it; return seconds without its imports."""
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "PYTHONPATH": "", "SVT_LOG": "1"}
    command = [python, str(DRIVER), "port", str(source), str(target)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    return float(done.stdout.strip().splitlines()[-1])


def measure(python: str, options: argparse.Namespace) -> list[Row]:
    """Return a row for every task and way."""
    took: dict[tuple[str, str], list[float]] = {}
    sizes: dict[tuple[str, str], float] = {}
    with tempfile.TemporaryDirectory(prefix="xpl-bench-") as name:
        folder = Path(name)
        make(folder / "set.hdf5", options.episodes, options.steps, options.size)
        for index in range(options.rounds):
            for task, way in (
                ("HDF5 to v3.0", "xpl"),
                ("HDF5 to v3.0", "LeRobot's recorder"),
            ):
                made = folder / f"made-{len(took)}-{index}"  # LeRobot's lists of videos bear no apostrophe
                source = folder / "set.hdf5"
                seconds = ours(source, made) if way == "xpl" else theirs(python, source, made)
                took.setdefault((task, way), []).append(seconds)
                sizes[task, way] = sum(one.stat().st_size for one in made.rglob("*") if one.is_file()) / 1e6
                shutil.rmtree(made)
    steps = options.episodes * options.steps
    return [
        Row(
            *key,
            round(statistics.median(seconds), 2),
            round(min(seconds), 2),
            round(max(seconds), 2),
            round(steps / statistics.median(seconds), 1),
            round(sizes[key], 2),
        )
        for key, seconds in took.items()
    ]


def main() -> int:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--steps", type=int, default=150)
    parser.add_argument("--size", type=int, default=256, help="pixels of a side, of each of two cameras")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="only show that it works; its figures mean nothing")
    parser.add_argument("--json", type=Path, help="write the rows to a file")
    options = parser.parse_args()
    if options.quick:
        options.episodes, options.steps, options.size, options.rounds = 2, 10, 64, 1
    python = os.environ.get("XPL_LEROBOT_PYTHON", "")
    if not python:
        print("not run: XPL_LEROBOT_PYTHON names no Python that has LeRobot")
        return 0
    rows = measure(python, options)
    print(f"{options.episodes} episodes of {options.steps} steps, two cameras of {options.size} x {options.size}")
    for row in rows:
        print(
            f"{row.task:14} {row.way:20} {row.median_s:8.2f} s ({row.min_s:.2f} to {row.max_s:.2f})  "
            f"{row.steps_per_s:8.1f} steps/s  {row.size_mb:7.2f} MB"
        )
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
