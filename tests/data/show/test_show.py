from __future__ import annotations

import io
import json
import sys
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from tests.data import datasets
from xpl_cli import main

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def test_a_page_holds_frames_and_curves_and_reaches_nothing(libero: Path, tmp_path: Path) -> None:
    """Every camera and column is on it, pictures are inside, and its policy allows no network."""
    assert main.main(["data", "show", str(libero), "--episode", "demo_1", "-o", str(tmp_path / "page.html")]) == 0
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    for word in ("demo_1", datasets.SENTENCE, "obs/agentview_rgb", "obs/ee_states", "default-src &#39;none&#39;"):
        assert word in page
    assert page.count("data:image/jpeg;base64,") == 16
    assert "http" not in page.replace("http-equiv", "")


def test_a_sheet_shows_the_pictures_of_the_file(
    libero: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is a PNG in which the first frame's colours are found; the answer names it."""
    command = ["data", "show", str(libero), "-o", str(tmp_path / "sheet.png"), "--frames", "4", "--json"]
    assert main.main(command) == 0
    assert json.loads(capsys.readouterr().out)["files"] == [str(tmp_path / "sheet.png")]
    sheet = np.asarray(Image.open(io.BytesIO((tmp_path / "sheet.png").read_bytes())))
    expected = datasets.picture(0)[::-1][5, 40]
    assert (np.abs(sheet.astype(int) - expected).sum(-1) == 0).any()


def test_what_cannot_be_shown_is_said(libero: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No such episode, another kind of file, no rerun-sdk: a sentence and the exit code that fits."""
    page = str(tmp_path / "page.html")
    assert main.main(["data", "show", str(libero), "--episode", "99", "-o", page]) == 3
    assert main.main(["data", "show", str(libero), "-o", str(tmp_path / "page.pdf")]) == 2
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main.main(["data", "show", str(libero), "--rerun", str(tmp_path / "a.rrd"), "-o", page]) == 4
    assert not list(tmp_path.iterdir())
