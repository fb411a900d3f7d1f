"""`xpl model-io show`: a page that reaches nothing, a picture, and all numbers as JSON."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image

from tests.support.adapters import parity, two_arm_adapter
from tests.support.outside.browser import browser
from tests.support.peer import xpl
from xpl import image_codec
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.model_io.show import page, predict_run, report, scene
from xpl_cli.model_io.show.cards import card
from xpl_cli.model_io.show.compiled_adapter import load_adapter
from xpl_cli.packages import package
from xpl_cli.standard import answers

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.model_io.show.compiled_adapter import CompiledAdapter
    from xpl_cli.model_io.show.scene import ReportScene

EXCHANGES = """
import numpy as np
from xpl import Policy


class Model(Policy):
    def load(self, config):
        pass

    def encode(self, obs, env):
        inputs = super().encode(obs, env)
        inputs["top"] = np.ascontiguousarray(inputs["top"][::-1])
        return inputs

    def predict(self, inputs, envs):
        return np.zeros((len(envs), 4, 16), np.float32)
"""
BY_HAND = """
import numpy as np
from xpl import Policy
from xpl.observation import get_image


class Model(Policy):
    def load(self, config):
        pass

    def encode(self, obs, env):
        picture = get_image(obs, "cam_left_wrist")[::8, ::-8, ::-1] / 255.0
        return {"views": [picture.astype(np.float32)], "text": obs["instruction"], "own": object()}

    def predict(self, inputs, envs):
        return np.zeros((len(envs), 4, 14), np.float32)
"""


def looked(folder: Path, model_io: dict[str, Any]) -> tuple[CompiledAdapter, ReportScene, report.ShowReport]:
    """Return an adapter with this block, what is shown to it, and what its model sees of that."""
    what = load_adapter(package.load(two_arm_adapter.write_adapter(folder, model_io)), {})
    view = scene.scripted(what.package.manifest, what.robot, what.cameras, 1)
    return what, view, report.report_from_block(what, view)


def test_the_page_the_picture_and_the_numbers_are_written(tmp_path: Path) -> None:
    folder = two_arm_adapter.write_adapter(tmp_path / "P", two_arm_adapter.block())
    done = xpl("model-io", "show", str(folder), "--out", "shown", "--json", cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    told = json.loads(done.stdout)
    assert answers.problems(told) == []
    assert told["files"] == ["shown/index.html", "shown/show.png"]
    text = (tmp_path / "shown/index.html").read_text(encoding="utf-8")
    assert "default-src &#39;none&#39;" in text
    assert set(re.findall(r'(?:src|href)="([a-z]+:)', text)) == {"data:"}
    assert not re.search(r"https?://", text)
    with Image.open(tmp_path / "shown/show.png") as opened:
        opened.verify()


@pytest.mark.slow
def test_a_browser_shows_the_page_without_asking_anybody(tmp_path: Path) -> None:
    _conventions(tmp_path / "P")
    path = tmp_path / "shown/index.html"
    with browser() as tab:
        for width, is_dark in ((1280, False), (400, True)):
            tab.open(f"file://{path}", width, dark=is_dark)
            assert tab("[...document.images].every(one => one.complete && one.naturalWidth > 0)")
            assert tab("document.querySelector('#image_channels mark').getBoundingClientRect().width") > 100
            assert tab("document.querySelector('svg .link').getBoundingClientRect().height") > 10
            assert tab("document.documentElement.scrollWidth") <= width
        assert [one for one in tab.requests if not one.startswith("file:")] == []
        assert tab.complaints == []


def test_words_of_strangers_are_words(tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>"
    model_io = two_arm_adapter.block(images=[two_arm_adapter.image(evil, "cam_head")])
    model_io["instruction"]["template"] = evil + "{instruction}"
    text = page.page(looked(tmp_path / "P", model_io)[-1])
    assert evil not in text
    assert "&lt;script&gt;" in text


REFERENCE = """CONVENTIONS = {
    "image_channels": "authors.py:5 frames",
    "gripper": "assumed: no config says it",
    "angle_unit": "authors.py:9",
}
"""
AUTHORS = "import cv2\n\n\ndef frames(path):\n    return cv2.imread(path)  # BGR frames <b>\n\n\n\nin_radians = True\n"


def _conventions(folder: Path) -> str:
    """Return the part of the page about conventions, of an adapter with a reference."""
    model_io = two_arm_adapter.block(
        images=[two_arm_adapter.image("top", "cam_head", layout={"unknown": "no transform names it"})]
    )
    model_io["action"]["reference"] = {"assumed": model_io["action"]["reference"], "why": "the paper <i>says</i> so"}
    two_arm_adapter.write_adapter(folder, model_io)
    (folder / "reference.py").write_text(REFERENCE)
    (folder / "authors.py").write_text(AUTHORS)
    done = xpl("model-io", "show", str(folder), "--out", "shown", cwd=folder.parent)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    return (folder.parent / "shown/index.html").read_text(encoding="utf-8").partition('<section id="conventions">')[2]


def test_the_page_quotes_the_cited_lines_beside_the_values_of_the_block(tmp_path: Path) -> None:
    """Escaped, the cited line marked, with whether it is known, and what contradicts it."""
    text = _conventions(tmp_path / "P")
    told = {part.partition('"')[0]: part for part in text.split('<article class="convention" id="')[1:]}
    assert "<code>channels: rgb</code>" in told["image_channels"]
    assert "<mark>    return cv2.imread(path)  # BGR frames &lt;b&gt;</mark>" in told["image_channels"]
    assert "<span>def frames(path):</span>" in told["image_channels"]
    assert "the block says rgb, and the code says bgr" in told["image_channels"]
    assert "the block says deg, and the code says radians" in told["angle_unit"]
    assert '<span class="standing known">' in told["angle_unit"]
    assert '<span class="standing assumed">' in told["gripper"]
    assert "assumed: no config says it" in told["gripper"]
    assert "layout: ?" in told["image_range"]
    assert '<span class="standing unknown">' in told["image_range"]
    assert "the paper &lt;i&gt;says&lt;/i&gt; so" in told["action_reference"]
    assert "none is named" in told["chunk"]


def _run(folder: Path) -> report.ShowReport:
    what = load_adapter(package.load(folder), {})
    view = scene.scripted(what.package.manifest, what.robot, what.cameras, what.reach)
    return report.report_from_run(what, view, predict_run.RunOptions())


def test_what_code_exchanges_is_seen_when_the_model_runs(tmp_path: Path) -> None:
    document = _run(two_arm_adapter.write_adapter(tmp_path / "P", two_arm_adapter.block(), EXCHANGES))
    top = next(view for view in document.views if view.input == "top")
    assert top.notes == ("red and blue exchanged",)
    assert any(note.startswith("top: numbers differ by up to") for note in document.notes)
    assert not any("wrist" in note for note in document.notes)
    assert document.action_from == "what the model answered"
    assert document.action[1].values["model"] == [0.0, 0.0]


def test_without_a_block_predict_is_watched_and_nothing_is_claimed(tmp_path: Path) -> None:
    document = _run(two_arm_adapter.write_adapter(tmp_path / "P", None, BY_HAND))
    (view,) = document.views
    assert (view.input, view.camera) == ("views[0]", "cam_left_wrist")
    assert view.notes == ("most like cam_left_wrist", "mirrored", "red and blue exchanged")
    assert "the meaning of these numbers is unknown" in document.notes[0]
    assert "own: '<builtins.object>'" in document.notes
    assert (document.vectors, document.action) == ((), ())


def test_without_a_block_and_without_running_nothing_can_be_shown(tmp_path: Path) -> None:
    folder = two_arm_adapter.write_adapter(tmp_path / "P", None)
    done = xpl("model-io", "show", str(folder), cwd=tmp_path)
    assert done.returncode == ExitCode.NOT_RUN
    assert "has no model_io block" in done.stderr
    assert "--run shows what predict gets" in done.stderr


def test_what_is_open_and_what_is_missing_is_told(tmp_path: Path) -> None:
    """A convention, a file of statistics, and one of samples; all else is shown with plain values."""
    rows = [{"file": "rows.npz", "key": "pose", "parts": [{"position": {"arm": "left"}}]}]
    unknown = two_arm_adapter.image("top", "cam_head", channels={"unknown": "no transform names it"})
    model_io = two_arm_adapter.block(images=[unknown], samples=rows)
    model_io["state"][0]["normalize"] = {"rule": "mean_std", "file": "stats.json"}
    _, _, document = looked(tmp_path / "P", model_io)
    told = "\n".join(document.notes)
    assert "images[0].channels" in told
    assert "stats.json is not there" in told
    (witness,) = document.witness
    assert "rows.npz" in witness


def test_pairs_are_shown_where_there_are_some(tmp_path: Path) -> None:
    folder = parity.write_adapter(tmp_path / "Foo")
    assert xpl("model-io", "record", str(folder), cwd=tmp_path).returncode == ExitCode.CLEAN
    what = load_adapter(package.load(folder), {})
    view, steps, told = report.first_pair(what) or pytest.fail("no pairs")
    document = report.report_from_block(what, view, (steps, told))
    assert document.action_from.startswith("what reference.py answered (golden_pairs.json, environment 0")
    assert len(steps) == 4
    assert all(abs(value) <= 1 for number in document.action[:7] for value in number.values["model"])


def test_photographs_and_environments_are_shown(tmp_path: Path) -> None:
    what, view, _ = looked(tmp_path / "P", two_arm_adapter.block())
    photo = np.zeros((30, 40, 3), np.uint8)
    photo[:, :20] = (200, 10, 10)
    (tmp_path / "photo.png").write_bytes(image_codec.encode_png(photo))
    pictured = scene.photographed(view, {"cam_head": tmp_path / "photo.png"})
    assert np.array_equal(report.report_from_block(what, pictured).views[0].taken, photo)
    with pytest.raises(UserError, match="no camera cam_foot"):
        scene.photographed(view, {"cam_foot": tmp_path / "photo.png"})
    with pytest.raises(UserError, match="is no picture"):
        scene.photographed(view, {"cam_head": tmp_path / "P" / "policy.yml"})
    real = scene.of_environment(
        scene.EnvironmentEpisode("mujoco", "lift_tray_bimanual"), what.robot, "joint", what.cameras
    )
    document = report.report_from_block(what, real)
    assert {view.notes for view in document.views} == {()}
    assert not np.array_equal(document.views[0].taken, card("cam_head", 0, *document.views[0].taken.shape[:2]))
    assert document.scene.origin == "the first observation of mujoco, lift_tray_bimanual, seed 0"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--task", "lift_cube"), "--task is of an environment"),
        (("--image", "photo.png"), "--image takes CAMERA=FILE"),
    ],
)
def test_options_that_do_not_fit_are_refused(arguments: tuple[Any, ...], words: str, tmp_path: Path) -> None:
    folder = two_arm_adapter.write_adapter(tmp_path / "P", two_arm_adapter.block())
    done = xpl("model-io", "show", str(folder), *arguments, cwd=tmp_path)
    assert done.returncode not in {ExitCode.CLEAN, ExitCode.INTERNAL}
    assert words in done.stderr
    assert not (tmp_path / "model-io-show").exists()
