"""What is wrong with a picture is seen, and said: colours, sides, cameras, moments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support.adapters import two_arm_adapter
from xpl_cli.model_io.show import image_transforms, report, scene
from xpl_cli.model_io.show.cards import card
from xpl_cli.model_io.show.compiled_adapter import load_adapter
from xpl_cli.packages import package

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.model_io.show.report import ShowReport
    from xpl_cli.model_io.show.views import ImageView

RED = (0.12, 0.12)
"""Where the card's R is, as shares of height and width: on its field, beside the letter."""


def shown(folder: Path, model_io: dict[str, Any]) -> ShowReport:
    """Return what a model with this block sees of the test cards."""
    what = load_adapter(package.load(two_arm_adapter.write_adapter(folder, model_io)), {})
    return report.report_from_block(what, scene.scripted(what.package.manifest, what.robot, what.cameras, what.reach))


def at(picture: np.ndarray, place: tuple[float, float] = RED) -> str:
    pixel = picture[round(place[0] * len(picture)), round(place[1] * picture.shape[1])]
    return ("red", "green", "blue")[int(np.argmax(pixel))]


def views(found_views: ShowReport) -> dict[str, ImageView]:
    return {view.input: view for view in found_views.views}


def test_a_right_block_shows_the_cameras_and_says_nothing(tmp_path: Path) -> None:
    found_views = views(shown(tmp_path / "P", two_arm_adapter.block()))
    assert {name: view.camera for name, view in found_views.items()} == {
        "top": "cam_head",
        "left_wrist": "cam_left_wrist",
        "right_wrist": "cam_right_wrist",
    }
    for view in found_views.values():
        assert view.notes == ()
        assert (view.shape, view.dtype, view.seen.shape) == ((3, 64, 64), "float32", (64, 64, 3))
        assert -1 <= view.values.min() < view.values.max() <= 1
        assert at(view.taken) == at(view.seen[8:56]) == at(view.raw[8:56]) == "red"


def test_blue_before_red_is_seen_in_the_numbers(tmp_path: Path) -> None:
    model_io = two_arm_adapter.block(images=[two_arm_adapter.image("top", "cam_head", channels="bgr")])
    view = views(shown(tmp_path / "P", model_io))["top"]
    assert at(view.seen[8:56]) == "red"
    assert at(view.raw[8:56]) == "blue"
    assert "channels bgr" in view.words


def test_exchanged_wrists_are_said(tmp_path: Path) -> None:
    model_io = two_arm_adapter.block(
        images=[
            two_arm_adapter.image("left_wrist", "cam_right_wrist"),
            two_arm_adapter.image("right_wrist", "cam_left_wrist"),
        ]
    )
    found_views = views(shown(tmp_path / "P", model_io))
    assert found_views["left_wrist"].notes == ("the input is called left_wrist, and shows cam_right_wrist",)
    assert found_views["right_wrist"].notes == ("the input is called right_wrist, and shows cam_left_wrist",)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("steps", "words"),
    [
        ([{"mirror": "left_right"}], ["mirrored"]),
        ([{"mirror": "up_down"}], ["upside down and mirrored"]),
        ([{"rotate": 180}], ["turned by 180 degrees"]),
        ([{"rotate": 90}, {"resize": {"to": [50, 40], "filter": "area"}}], ["turned by 90 degrees"]),
        ([{"crop": {"fraction": 0.8}}, {"mirror": "left_right"}], ["mirrored"]),
        ([{"crop": {"fraction": 0.9}}, {"resize": {"to": [40, 40], "filter": "area"}}], []),
    ],
)
def test_turned_and_mirrored_pictures_are_said(steps: list[dict[str, Any]], words: list[str], tmp_path: Path) -> None:
    model_io = two_arm_adapter.block(images=[two_arm_adapter.image("top", "cam_head", steps=steps)])
    assert list(views(shown(tmp_path / "P", model_io))["top"].notes) == words


def test_red_and_blue_exchanged_on_the_way_are_said() -> None:
    taken = card("cam_head", 0, 120, 160)
    assert image_transforms.describe_transform(taken[..., ::-1], taken, {}) == ["red and blue exchanged"]
    assert image_transforms.describe_transform(taken[:, ::-1, ::-1], taken, {}) == [
        "mirrored",
        "red and blue exchanged",
    ]
    grey = np.full_like(taken, 90)
    assert image_transforms.describe_transform(grey, grey, {}) == []


def test_history_shows_its_moments(tmp_path: Path) -> None:
    model_io = two_arm_adapter.block(
        history={"length": 3, "stride": 2}, images=[two_arm_adapter.image("top", "cam_head")]
    )
    found_views = shown(tmp_path / "P", model_io)
    assert [view.when for view in found_views.views] == [0, 2, 4]
    for view in found_views.views:
        told = "now" if view.when == 0 else f"{view.when} steps ago"
        assert np.array_equal(view.taken, card("cam_head", 0, *view.taken.shape[:2], told))
        assert view.notes == ()
