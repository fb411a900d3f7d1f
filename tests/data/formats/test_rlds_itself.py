"""tensorflow-datasets writes RLDS in the form of DROID, and it is read through it, in a Python that has it.

`XPL_TFDS_PYTHON` names that Python; CONTRIBUTING.md says how to make one. Without it this is not run.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.data.formats import rlds_driver
from tests.support.checkout import ROOT
from xpl_cli.data.formats import image_files
from xpl_cli.data.reading import open_set

PYTHON = os.environ.get("XPL_TFDS_PYTHON", "")
LOSSY_DB = 33.0

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not PYTHON, reason="not run: XPL_TFDS_PYTHON names no Python that has tensorflow-datasets"),
]


def _run(*arguments: str | Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TF_CPP_MIN_LOG_LEVEL": "3"}
    command = [PYTHON, rlds_driver.__file__, *map(str, arguments)]
    completed = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert completed.returncode == 0, completed.stderr[-2000:]


def test_what_tensorflow_datasets_writes_is_read_and_converted(tmp_path: Path) -> None:
    """Numbers exactly, images as JPEG keeps them, in any order of asking; a conversion has every episode as it was."""
    _run("write", tmp_path / "rlds", tmp_path / "written.npz")
    root = tmp_path / "rlds" / "droid_small" / "1.0.0"
    _run("read", root, tmp_path / "read.npz", tmp_path / "made")
    written, dataset = np.load(tmp_path / "written.npz"), np.load(tmp_path / "read.npz")
    for name in written.files:
        np.testing.assert_array_equal(dataset[name], written[name], err_msg=name)
    wordings = []
    for index in range(rlds_driver.EPISODES):
        length = int(dataset[f"{index}/length"])
        assert length == 4 + index
        assert dataset[f"{index}/is_last"].tolist() == [False] * (length - 1) + [True]
        for place, camera in enumerate(rlds_driver.CAMERAS):
            frames = dataset[f"{index}/observation/{camera}"]
            worst = min(image_files.psnr(frames[step], rlds_driver.image(step + 40 * place)) for step in range(length))
            assert worst > LOSSY_DB
        wordings.append(dataset[f"{index}/told"].tolist())
    assert wordings[:2] == [["put the pen in the cup"], ["put the pen in the cup", "pen into cup"]]
    target = open_set(tmp_path / "made")
    told = [target[index].extras["episode_metadata/file_path"] for index in range(len(target))]
    for index, name in enumerate(told):
        number = name.removeprefix("/raw/")
        np.testing.assert_array_equal(target[index].read("action"), written[f"{number}/action"])
    assert sorted(told) == [f"/raw/{index}" for index in range(rlds_driver.EPISODES)]
