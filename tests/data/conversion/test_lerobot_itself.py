"""LeRobot in its own Python opens what was converted, and what it wrote is read here.

`XPL_LEROBOT_PYTHON` names a Python that has LeRobot 0.4, as CONTRIBUTING.md tells. Without it this is not run.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from xpl_cli.data.formats import image_files
from xpl_cli.data.reading import open_set

if TYPE_CHECKING:
    from collections.abc import Callable

    Converted = Callable[..., Any]

PYTHON = os.environ.get("XPL_LEROBOT_PYTHON", "")
DRIVER = Path(__file__).with_name("lerobot_driver.py")
LOSSY_DB = 33.0

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not PYTHON, reason="not run: XPL_LEROBOT_PYTHON names no Python that has LeRobot"),
]


def lerobot(*arguments: str | Path) -> None:
    """Let LeRobot work, far from any hub."""
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "PYTHONPATH": ""}
    command = [PYTHON, str(DRIVER), *map(str, arguments)]
    completed = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert completed.returncode == 0, completed.stderr[-2000:]


def test_lerobot_opens_what_was_converted(libero: Path, tmp_path: Path, converted: Converted) -> None:
    """Every item has the numbers, the sentence and the picture of its step, in the files of several episodes."""
    converted(libero, tmp_path / "set", "lerobot-v3.0", file_mb=0.02)
    lerobot("read", tmp_path / "set", tmp_path / "items.npz")
    items, source = np.load(tmp_path / "items.npz"), open_set(libero)
    begins = 0
    for index in range(len(source)):
        episode = source[index]
        place = slice(begins, begins + episode.length)
        begins = place.stop
        assert set(items["tasks"][place]) == set(episode.instructions)
        np.testing.assert_array_equal(items["episode_index"][place], index)
        for name, column in (("action", "actions"), ("observation.joint_states", "obs/joint_states")):
            np.testing.assert_array_equal(items[name][place], episode.read(column).astype(np.float32))
        for name in ("agentview_rgb", "eye_in_hand_rgb"):
            frames = np.rint(items[f"observation.images.{name}"][place] * 255).astype(np.uint8).transpose(0, 2, 3, 1)
            for image, frame in zip(frames, episode.frames(f"obs/{name}"), strict=True):
                assert image_files.psnr(image, frame) > LOSSY_DB
    assert begins == len(items["tasks"])


def test_what_lerobot_wrote_is_read(tmp_path: Path, converted: Converted) -> None:
    """Numbers exactly, images of tables exactly, those of videos nearly; and again after a conversion."""
    lerobot("write", tmp_path / "set", tmp_path / "kept.npz")
    expected = np.load(tmp_path / "kept.npz")
    assert not converted(tmp_path / "set", tmp_path / "again", "lerobot-v3.0").lossy
    for dataset in (open_set(tmp_path / "set"), open_set(tmp_path / "again")):
        assert (dataset.robot, dataset.rate_hz, len(dataset)) == ("panda", 20.0, 3)
        for index in range(3):
            episode = dataset[index]
            assert episode.instructions == (("pick", "place")[index % 2],)
            for name in ("observation.state", "action", "force"):
                np.testing.assert_array_equal(episode.read(name), expected[f"{index}/{name}"])
            wrist = np.stack(list(episode.frames("observation.images.wrist")))
            np.testing.assert_array_equal(wrist, expected[f"{index}/observation.images.wrist"])
            top = expected[f"{index}/observation.images.top"]
            for image, frame in zip(episode.frames("observation.images.top"), top, strict=True):
                assert image_files.psnr(image, frame) > LOSSY_DB
