from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.data import datasets
from xpl import get_embodiment, trajectory
from xpl.convert.frames import PoseFrame
from xpl_cli.basics import parallel
from xpl_cli.basics.errors import UnknownNameError
from xpl_cli.data.formats import image_files
from xpl_cli.data.formats.lerobot import layout
from xpl_cli.data.reading import open_set
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.summary import DatasetSummary

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from xpl_cli.data.conversion.job import ConversionReport
    from xpl_cli.data.sets.interface import RecordedEpisode

    Converted = Callable[..., Any]

EXACT = float("inf")
LOSSY_DB = 33.0
"""PSNR that videos and JPEGs of smooth pictures keep at least."""


def worst(one: RecordedEpisode, other: RecordedEpisode) -> float:
    """Return the lowest PSNR of the images of two episodes, dB."""
    return min(
        image_files.psnr(first, second)
        for name in one.cameras
        for first, second in zip(one.frames(name), other.frames(name), strict=True)
    )


@pytest.fixture(scope="module")
def in_lerobot(
    libero: Path, tmp_path_factory: pytest.TempPathFactory, converted: Converted
) -> tuple[Path, ConversionReport]:
    """Return LIBERO's set as one of LeRobot with videos, and what its conversion reported."""
    target = tmp_path_factory.mktemp("lerobot") / "set"
    return target, converted(libero, target, "lerobot-v3.0", codec="h264", crf=18)


@pytest.mark.parametrize("at_least", [LOSSY_DB, EXACT])
def test_a_set_of_the_field_becomes_one_of_lerobot(
    at_least: float, libero: Path, in_lerobot: tuple[Path, ConversionReport], tmp_path: Path, converted: Converted
) -> None:
    """Numbers exactly, under names that the report tells, with sentences, rate and robot; images as the format says."""
    target, report = in_lerobot
    if at_least == EXACT:
        target = tmp_path / "there"
        report = converted(libero, target, "lerobot-v3.0", images="png")
    assert not report.lost
    assert bool(report.lossy) == (at_least != EXACT)
    before, after = open_set(libero), open_set(target)
    assert (after.format, after.rate_hz, after.robot, len(after)) == ("lerobot-v3.0", 20.0, "Panda", 3)
    old = {new: report.renamed.get(new, new) for new in (*after[0].columns, *after[0].cameras)}
    assert set(old.values()) == {*before[0].columns, *before[0].cameras, *layout.DEFAULTS}
    for index in range(3):
        one, other = before[index], after[index]
        assert (one.length, one.instructions) == (other.length, other.instructions)
        for name in other.columns:
            if name not in layout.DEFAULTS:
                rows = one.read(old[name])  # a single number is an array of one in LeRobot
                np.testing.assert_array_equal(other.read(name).reshape(rows.shape), rows, err_msg=name)
        for name in other.cameras:
            for first, second in zip(one.frames(old[name]), other.frames(name), strict=True):
                assert image_files.psnr(first, second) >= at_least


def test_statistics_are_those_of_the_numbers(libero: Path, in_lerobot: tuple[Path, ConversionReport]) -> None:
    """Mean, spread and range over all episodes, by which LeRobot's policies normalise."""
    statistics = json.loads((in_lerobot[0] / "meta" / "stats.json").read_text(encoding="utf-8"))["action"]
    rows = np.concatenate([open_set(libero)[index].read("actions") for index in range(3)])
    np.testing.assert_allclose(statistics["mean"], rows.mean(0), atol=1e-12)
    np.testing.assert_allclose(statistics["std"], rows.std(0), atol=1e-12)
    np.testing.assert_allclose(statistics["max"], rows.max(0))
    assert statistics["count"] == [len(rows)]


def test_a_mapping_leads_to_the_standard_and_back(libero: Path, tmp_path: Path, converted: Converted) -> None:
    """Pictures are upright, an opening is 0..1, changes of pose become poses; back, numbers are the same to 1e-12.

    An action of 1 moves the point between the fingers by 5 cm along that axis of the world, from the state of its step.
    """
    converted(libero, tmp_path / "xpl", "xpl", by="libero", images="raw")
    episode = open_set(tmp_path / "xpl")[0]
    source = open_set(libero)[0]
    fingers = source.read("obs/gripper_states")
    np.testing.assert_allclose(episode.read("state/ee_joint_states")[:, 0], fingers[:, 0] / 0.04)
    np.testing.assert_array_equal(next(episode.frames("vision/cam_head/colors")), datasets.picture(0))
    assert {"action/ee_poses", "action/ee_joint_states", "dones"} <= set(episode.columns)
    tool = PoseFrame(get_embodiment("panda_libero"), "single", "tcp", "world")
    moved = tool.encode(episode.read("action/ee_poses"))[:, :3] - tool.encode(episode.read("state/ee_poses"))[:, :3]
    np.testing.assert_allclose(moved, source.read("actions")[:, :3] * 0.05, atol=1e-12)
    converted(tmp_path / "xpl", tmp_path / "back", "lerobot-v3.0", by="libero", images="png")
    back = open_set(tmp_path / "back")[0]
    assert set(back.columns) == {name.replace("/", ".") for name in source.columns} | set(layout.DEFAULTS)
    for name, rows in datasets.numbers(source).items():
        there = back.read(name.replace("/", ".")).reshape(rows.shape)
        np.testing.assert_allclose(there, rows, atol=1e-12, err_msg=name)
    for name in source.cameras:
        for first, second in zip(source.frames(name), back.frames(name.replace("/", ".")), strict=True):
            np.testing.assert_array_equal(first, second)


def test_robotwin_is_read_in_true_colours_and_one_step_late(tmp_path: Path, converted: Converted) -> None:
    """Red is red again, the action is the next state, and all sentences and matrices stay."""
    source = datasets.robotwin(tmp_path / "robotwin")
    converted(source, tmp_path / "xpl", "xpl", by="robotwin", rate_hz=25.0)
    episode = open_set(tmp_path / "xpl")[0]
    assert image_files.psnr(next(episode.frames("vision/cam_head/colors")), datasets.picture(0)) > LOSSY_DB
    np.testing.assert_array_equal(
        episode.read("action/left_arm_joint_states")[:-1], episode.read("state/left_arm_joint_states")[1:]
    )
    assert episode.instructions == ("stack them", "pile them up", "build a tower")
    converted(tmp_path / "xpl", tmp_path / "back", "lerobot-v3.0", by="robotwin", images="png")
    back = open_set(tmp_path / "back")[0]
    for name, rows in datasets.numbers(open_set(source)[0]).items():
        there = back.read(name.replace("/", ".")).reshape(rows.shape)
        np.testing.assert_array_equal(there, rows, err_msg=name)
    assert image_files.psnr(next(back.frames("observation.head_camera.rgb")), datasets.picture(0)[..., ::-1]) > LOSSY_DB


def test_the_standards_series_are_one_vector_in_lerobot_and_series_again_after_it(
    libero: Path, tmp_path: Path, converted: Converted
) -> None:
    """State and action have a name for each number there, and nothing changes on the way back."""
    converted(libero, tmp_path / "xpl", "xpl", by="libero", images="raw")
    converted(tmp_path / "xpl", tmp_path / "lerobot", "lerobot-v3.0", images="png")
    columns = open_set(tmp_path / "lerobot")[0].columns
    assert columns["observation.state"].names[-2:] == ("arm_joint_state_6", "ee_joint_state")
    assert columns["action"].shape == (8,)
    converted(tmp_path / "lerobot", tmp_path / "back", "xpl")
    for index in range(3):
        datasets.same(open_set(tmp_path / "xpl")[index], open_set(tmp_path / "back")[index])


def test_videos_are_copied_and_not_encoded_again(
    in_lerobot: tuple[Path, ConversionReport], tmp_path: Path, converted: Converted
) -> None:
    """Within v3.0, and from v2.1, pixels are the same, whatever file an episode lies in."""
    for source in (in_lerobot[0], datasets.lerobot_v21(tmp_path / "older")):
        target = tmp_path / f"{source.name} again"
        assert not converted(source, target, "lerobot-v3.0", file_mb=0.001).lossy
        before, after = open_set(source), open_set(target)
        assert len(list(target.rglob("*.mp4"))) == len(before) * len(before[0].cameras)
        for index in range(len(before)):
            datasets.same(before[index], after[index])
            assert worst(before[index], after[index]) == EXACT


def test_a_run_that_ended_goes_on(
    libero: Path,
    in_lerobot: tuple[Path, ConversionReport],
    tmp_path: Path,
    converted: Converted,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What is there is not written again, nothing lies at the target before, and the result is that of one run."""
    monkeypatch.setattr(parallel, "map_in_processes", lambda each, things, workers: _ended_after_two(each, things))
    with pytest.raises(KeyboardInterrupt):
        converted(libero, tmp_path / "set", "lerobot-v3.0", codec="h264", crf=18)
    monkeypatch.undo()
    assert not (tmp_path / "set").exists()
    assert converted(libero, tmp_path / "set", "lerobot-v3.0", codec="h264", crf=18).resumed == 2
    assert [entry.name for entry in tmp_path.iterdir()] == ["set"]
    datasets.same(open_set(tmp_path / "set")[2], open_set(in_lerobot[0])[2])


def _ended_after_two(each: Any, items: Any) -> Any:
    for item in items[:2]:
        yield each(item)
    raise KeyboardInterrupt


def test_what_a_format_cannot_hold_is_said(tmp_path: Path, libero: Path, converted: Converted) -> None:
    """One sentence for each, and nothing is left: no rate, other images, a target that is there, a read-only format."""
    source = datasets.robotwin(tmp_path / "robotwin")
    for to, sentence in (("lerobot-v3.0", "steps per second"), ("xpl", "state/ or action/")):
        with pytest.raises(DataError, match=sentence):
            converted(source, tmp_path / "set", to)
    with pytest.raises(DataError, match="no mapping 'nobody'"):
        converted(libero, tmp_path / "set", "xpl", by="nobody")
    (tmp_path / "mine.yml").write_text("robot: panda_libero\naction: { columns: [] }\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"mine\.yml:\d+:\d+"):
        converted(libero, tmp_path / "set", "xpl", by=str(tmp_path / "mine.yml"))
    with pytest.raises(DataError, match="exists already"):
        converted(libero, source, "lerobot-v3.0")
    for to, images in (("lerobot-v3.0", "raw"), ("xpl", "video")):
        with pytest.raises(DataError, match="--images"):
            converted(libero, tmp_path / "set", to, images=images, by="libero" if to == "xpl" else None)
    for to in ("robomimic", "aloha", "robotwin", "diffusion-policy", "lerobot-v2.1"):
        with pytest.raises(UnknownNameError, match="--to"):
            converted(libero, tmp_path / "set", to)
    assert not list(tmp_path.glob(".*"))


def test_what_a_simulator_told_is_one_vector_of_lerobot_and_what_it_was_after_it(
    tmp_path: Path, converted: Converted
) -> None:
    """Fractions become `observation.environment_state`, each with its name; the rest keeps its own; all comes back."""
    with trajectory.Writer(tmp_path / "xpl" / "episode_0000000.hdf5", frequency=25.0, privileged=True) as writer:
        for step in range(4):
            joint = {"arm_joint_state": np.full(2, step, np.float32), "ee_joint_state": np.ones(1, np.float32)}
            truth = {"cube": {"pose": np.arange(7.0) * step}, "height": 0.5 * step, "held": step > 2, "task": "lift"}
            writer.add({"state": joint, "instruction": "lift it", "privileged": truth}, joint)
    converted(tmp_path / "xpl", tmp_path / "there", "lerobot-v3.0")
    there = open_set(tmp_path / "there")[0]
    column = there.columns["observation.environment_state"]
    assert (column.shape, column.names) == ((8,), (*(f"cube.pose_{index}" for index in range(7)), "height"))
    assert there.columns["additional_info.steps.privileged.held"].dtype == "bool"
    extras = DatasetSummary.of(open_set(tmp_path / "there")).as_json()["privileged"]
    assert extras == {"recorded": ["cube/pose", "height", "held"], "left_out": {"task": "is no array of numbers"}}
    converted(tmp_path / "there", tmp_path / "back", "xpl")
    datasets.same(open_set(tmp_path / "xpl")[0], open_set(tmp_path / "back")[0])
    columns = trajectory.open_folder(tmp_path / "back")[0].observation(3)["privileged"]
    assert (columns["cube"]["pose"].tolist(), columns["height"]) == ((np.arange(7.0) * 3).tolist(), 1.5)
