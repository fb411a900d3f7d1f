"""Trajectories: what is written is read back as it was, in every form; nothing is half there, and nothing leads out."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.support.examples import examples
from xpl import _spec as sdk
from xpl import image_codec, trajectory
from xpl.trajectory import TrajectoryError, Writer

_SERIES = st.sampled_from(("arm_joint_state", "ee_joint_state", "ee_pose", "tcp_pose", "delta_ee_pose", "force"))
_WORDS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=12)


@st.composite
def _episodes(draw: Any) -> list[tuple[dict[str, Any], dict[str, Any], dict[str, Any]]]:
    prefixes = sdk.ARM_PREFIXES[draw(st.sampled_from((1, 2)))]
    names = [prefix + name for prefix in prefixes for name in draw(st.sets(_SERIES, min_size=1))]
    shapes = {name: (draw(st.integers(0, 7)), draw(st.sampled_from(("<f4", "<f8", "<i8")))) for name in names}
    camera = draw(st.sampled_from(("cam_head", "third view")))
    bits = np.random.default_rng(draw(st.integers(0, 9)))  # numbers of any kind: infinite, none at all, the smallest

    def array(shape: tuple[int, ...], dtype: str) -> np.ndarray:
        return np.frombuffer(bits.bytes(int(np.prod(shape)) * np.dtype(dtype).itemsize), dtype).reshape(shape)

    size = draw(st.tuples(st.integers(1, 9), st.integers(1, 9)))
    parts = draw(st.sets(st.sampled_from(("color", "depth", "intrinsic_matrix", "extrinsics_matrix", "shape"))))
    steady = {"intrinsic_matrix": array((3, 3), "<f8"), "shape": np.array(size)}
    words = draw(st.lists(_WORDS, min_size=1, max_size=3))
    steps = []
    for number in range(draw(st.integers(1, 4))):
        row = {name: array((length,), dtype) for name, (length, dtype) in shapes.items()}
        seen = {
            "color": array((*size, 3), "|u1"),
            "depth": array(size, "<f4"),
            "extrinsics_matrix": array((4, 4), "<f4"),
            **steady,
        }
        obs = {
            "data_format_version": "v1.0",
            "instruction": words[number % len(words)],
            "instructions": words,
            "additional_info": {"frequency": 25},
            "vision": {camera: {part: seen[part] for part in sorted(parts)}} if parts else {},
            "state": {**row, "mobile": {"base_pose": array((7,), "<f4")}},
            "touch": {"left": array((2, 2), "<f4")},
        }
        facts = {"asked": draw(st.booleans()), "note": draw(_WORDS)}
        steps.append((obs, row, facts))
    return steps


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, dict):
        return isinstance(other, dict) and one.keys() == other.keys() and all(_same(one[k], other[k]) for k in one)
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    return bool(one == other)


def test_what_a_simulator_tells_is_kept_on_request_its_numbers_that_stay_in_form(tmp_path: Path) -> None:
    path = tmp_path / "episode_0000000.hdf5"
    told = [
        {
            "cube": {"pose": np.arange(7.0) + step, "held": step > 1, "name": "cube"},
            "mask": np.full((4, 5), step, np.int16),
            "expert": {"ee_pose": np.zeros(7)},
            "rows": np.zeros((step + 1, 2)),
            "a/b": 1.0,
            **({"late": 2.0} if step else {"early": 3.0}),
        }
        for step in range(3)
    ]
    with Writer(path, privileged=True) as writer:
        for truth in told:
            writer.add({"state": {"ee_joint_state": np.zeros(1)}, "privileged": truth}, {"ee_joint_state": np.zeros(1)})
    with trajectory.read(path) as found:
        for step, truth in enumerate(told):
            shown = found.observation(step)["privileged"]
            kept = {"pose": truth["cube"]["pose"], "held": truth["cube"]["held"]}
            assert _same(shown, {"cube": kept, "mask": truth["mask"]})
        assert found.facts(0) == {}
        facts = found.episode["privileged"]
    assert facts["recorded"] == ["cube/held", "cube/pose", "mask"]
    assert facts["left_out"] == {
        "a/b": "cannot name a dataset",
        "cube/name": "is no array of numbers",
        "early": "is not there in step 1, unlike before",
        "expert": "is what an expert does now, which `action` has",
        "late": "is not there before step 1",
        "rows": "is float64 of shape (2, 2) in step 1, unlike before",
    }


@settings(max_examples=examples(20), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(episode=_episodes(), form=st.sampled_from(("raw", "png")))
def test_every_step_is_read_back_as_it_was(tmp_path: Path, episode: list[Any], form: str) -> None:
    path = tmp_path / "episode_0000000.hdf5"
    with Writer(path, images=form, episode={"seed": 3, "of": [1, None]}, subtasks=[{"start": 0}]) as writer:
        for obs, action, facts in episode:
            writer.add({**obs, "env_idx": 0, "privileged": {"cube": 1.0}}, action, **facts)
    with trajectory.read(path) as found:
        assert len(found) == len(episode)
        for step, (obs, action, facts) in enumerate(episode):
            expected = {key: value for key, value in obs.items() if value != {}}
            assert _same(expected, found.observation(step))
            assert _same(action, found.action(step))
            assert facts == found.facts(step)
        assert found.frequency == 25.0
        assert found.instructions == tuple(episode[0][0]["instructions"])
        assert (found.episode, found.subtasks) == ({"seed": 3, "of": [1, None]}, [{"start": 0}])


def _obs(step: int = 0, **changed: Any) -> dict[str, Any]:
    ramp = np.linspace(0, 255, 32 * 40).reshape(32, 40)
    image = np.stack([ramp, 255 - ramp, np.full((32, 40), 20.0 * step)], axis=2).astype(np.uint8)
    state = {"arm_joint_state": np.full(6, step, np.float32), "ee_joint_state": np.ones(1, np.float32)}
    return {"instruction": "lift", "vision": {"cam_head": {"color": image}}, "state": state, **changed}


def _written(path: Path, steps: int = 3, **options: Any) -> Path:
    with Writer(path, **options) as writer:
        for step in range(steps):
            writer.add(_obs(step), _obs(step)["state"])
    return path


@pytest.mark.parametrize(("form", "stored"), [("jpeg", (70,)), ("jpeg-padded", (70, ...))])
def test_jpegs_are_standard_ones_in_both_forms(tmp_path: Path, form: str, stored: tuple[Any, ...]) -> None:
    path = _written(tmp_path / "a.hdf5", steps=70, images=form)
    with h5py.File(path) as file:
        data = file["vision/cam_head/colors"]
        assert data.shape[: len(stored)] == tuple(data.shape[1] if size is ... else size for size in stored)
        assert image_codec.has_marker(bytes(data[69].tobytes()))
    found = trajectory.read(path)
    seen, expected = found.image("cam_head", 9), _obs(9)["vision"]["cam_head"]["color"]
    assert np.abs(seen.astype(int) - expected.astype(int)).max() < 16
    assert found.form("cam_head") == (32, 40, "jpeg")


def test_images_that_come_encoded_are_kept_as_they_are(tmp_path: Path) -> None:
    """Also old ones, in which red and blue are exchanged: the reader knows them by their missing marker."""
    from PIL import Image

    red = np.zeros((8, 8, 3), np.uint8) + np.array([250, 20, 20], np.uint8)
    Image.fromarray(red[:, :, ::-1]).save(tmp_path / "old.jpg", quality=95)
    old = (tmp_path / "old.jpg").read_bytes()
    with Writer(tmp_path / "a.hdf5") as writer:
        writer.add(_obs(vision={"cam_head": {"color": old}}), {"ee_pose": np.zeros(7)})
    found = trajectory.read(tmp_path / "a.hdf5")
    assert found.datasets["vision", "cam_head", "colors"][0].tobytes() == old
    assert np.abs(found.image("cam_head", 0).astype(int) - red).max() < 12


def test_files_of_the_field_are_read(tmp_path: Path) -> None:
    """Instructions as JSON, images as texts of one length, depth and one gripper without an axis of their own."""
    jpegs = [image_codec.encode_jpeg(_obs(step)["vision"]["cam_head"]["color"]) for step in range(2)]
    with h5py.File(tmp_path / "episode_0000000.hdf5", "w") as file:
        file["instructions"] = json.dumps(["lift the cube", "pick it up"])
        file["additional_info/frequency"] = 25
        file["vision/cam_head/colors"] = np.array(jpegs, f"S{max(map(len, jpegs)) + 9}")
        file["vision/cam_head/extrinsic_matrix"] = np.stack([np.eye(4), 2 * np.eye(4)])
        file["state/left_arm_joint_states"] = np.zeros((2, 6))
        file["state/left_ee_joint_states"] = np.array([0.0, 1.0])
        file["action/left_arm_joint_states"] = np.zeros((2, 6))
    found = trajectory.read(tmp_path / "episode_0000000.hdf5")
    obs = found.observation(1)
    assert (obs["instruction"], obs["instructions"]) == ("lift the cube", ["lift the cube", "pick it up"])
    assert obs["vision"]["cam_head"]["color"].shape == (32, 40, 3)
    assert obs["vision"]["cam_head"]["extrinsics_matrix"][0, 0] == 2.0
    assert obs["state"]["left_ee_joint_state"].tolist() == [1.0]
    assert obs["additional_info"] == {"frequency": 25}


def test_nothing_is_left_of_an_episode_that_breaks_off(tmp_path: Path) -> None:
    path = _written(tmp_path / "a.hdf5")
    before = path.read_bytes()

    def broken() -> None:
        with Writer(path) as writer:
            writer.add(_obs(), _obs()["state"])
            raise RuntimeError("the arm stopped")

    with pytest.raises(RuntimeError, match="the arm stopped"):
        broken()
    assert path.read_bytes() == before
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.hdf5", "index.jsonl"]


def test_steps_that_differ_are_refused_with_what_was_expected(tmp_path: Path) -> None:
    state = {"arm_joint_state": np.zeros(6, np.float32)}
    for changed, told in (
        ({"state": state}, "step 1 lacks state/ee_joint_states"),
        ({"touch": 1.0}, "step 1 adds touch"),
        ({"state": {**_obs()["state"], "arm_joint_state": np.zeros(7)}}, r"expected \(6,\) float32.*got \(7,\)"),
        ({"state": {}}, "step 1 has no state"),
        ({"state": {**_obs()["state"], "arm_joint_state": ["a"] * 6}}, "expected numbers|expected .*6"),
    ):
        with Writer(tmp_path / "a.hdf5") as writer:
            writer.add(_obs(), _obs()["state"])
            with pytest.raises(TrajectoryError, match=told):
                writer.add(_obs(**changed), _obs()["state"])
    with pytest.raises(TrajectoryError, match="at least one step"), Writer(tmp_path / "b.hdf5"):
        pass


def test_an_episode_that_is_put_part_by_part_is_read_by_parts(tmp_path: Path) -> None:
    """Also texts, unknown names, and numbers that have as many rows as there are steps but hold for all of them."""
    frames = [_obs(step)["vision"]["cam_head"]["color"] for step in range(3)]
    with Writer(tmp_path / "a.hdf5", images="png") as writer:
        writer.put("state/arm_joint_state", np.eye(3))
        writer.put("action/arm_joint_states", np.eye(3))
        writer.put("additional_info/mode", ["a", "a", "a"])
        writer.put_images("touch/left", frames)
        writer.put_constant("vision/cam_head/intrinsic_matrix", np.eye(3))
        writer.put_constant("instructions", ["lift", "pick"])
        with pytest.raises(TrajectoryError, match="already"):
            writer.put("state/arm_joint_states", np.eye(3))
    with trajectory.read(tmp_path / "a.hdf5") as found:
        assert sorted(found.columns) == ["action/arm_joint_states", "additional_info/mode", "state/arm_joint_states"]
        assert found.rows("additional_info/mode", 1).tolist() == ["a", "a"]
        assert list(found.pictures) == ["touch/left"]
        np.testing.assert_array_equal(list(found.frames("touch/left", 1)), frames[1:])
        assert found.rest["vision/cam_head/intrinsic_matrix"] == np.eye(3).tolist()
        assert found.instructions == ("lift", "pick")
    writer = Writer(tmp_path / "b.hdf5")
    writer.put("state/arm_joint_states", np.eye(3))
    with pytest.raises(TrajectoryError, match="2 steps"):
        writer.put("action/arm_joint_states", np.eye(3)[:2])
    writer.discard()


def test_a_folder_is_listed_without_opening_a_file(tmp_path: Path) -> None:
    """Lengths come from the index; files that are none prove that nobody looked into them."""
    lines = []
    for number in range(200):
        (tmp_path / f"episode_{number:07d}.hdf5").write_bytes(b"no HDF5")
        lines.append(json.dumps({"file": f"episode_{number:07d}.hdf5", "bytes": 7, "steps": number}))
    (tmp_path / "index.jsonl").write_text("\n".join([*lines, "{torn"]), encoding="utf-8")
    (tmp_path / ".episode_9.hdf5.part").write_bytes(b"")
    found = trajectory.open_folder(tmp_path)
    assert (len(found), found.steps) == (200, sum(range(200)))
    assert (found.keys[7], len(found[7])) == ("episode_0000007", 7)
    with pytest.raises(TrajectoryError, match="cannot be read as HDF5"):
        found[7].observation(0)


def test_an_index_that_is_wrong_or_missing_costs_only_time(tmp_path: Path) -> None:
    """A file that was replaced by one of another size is opened instead; sets may lie in folders of folders."""
    _written(tmp_path / "a" / "one.hdf5", steps=3)
    _written(tmp_path / "b" / "two.h5", steps=4, indexed=False)
    _written(tmp_path / "a" / "one.hdf5", steps=5, indexed=False)
    found = trajectory.open_folder(tmp_path)
    assert [(one.key, len(one)) for one in found] == [("a/one", 5), ("b/two", 4)]
    with pytest.raises(TrajectoryError, match="holds no file"):
        trajectory.open_folder(_empty(tmp_path))
    with pytest.raises(TrajectoryError, match="is not there"):
        trajectory.open_folder(tmp_path / "nowhere")


def _empty(tmp_path: Path) -> Path:
    (tmp_path / "empty").mkdir()
    return tmp_path / "empty"


def test_nothing_outside_of_the_file_is_read(tmp_path: Path) -> None:
    other = _written(tmp_path / "other.hdf5")
    (tmp_path / "secret").write_bytes(bytes(48))
    for number, plant in enumerate(
        (
            lambda file: file.__setitem__("state/ee_poses", h5py.ExternalLink(str(other), "state/arm_joint_states")),
            lambda file: file.__setitem__("state/ee_poses", h5py.SoftLink("/action/arm_joint_states")),
            lambda file: file.create_dataset("state/ee_poses", (1, 6), "f8", external=str(tmp_path / "secret")),
            lambda file: file.create_dataset("state/ee_poses", (1, 1 << 40), "f4", chunks=(1, 64)),
        )
    ):
        path = tmp_path / f"{number}.hdf5"
        with h5py.File(path, "w") as file:
            file["state/arm_joint_states"] = file["action/arm_joint_states"] = np.zeros((1, 6))
            plant(file)
        with pytest.raises(TrajectoryError, match=r"is a link|in other files|bytes each"):
            trajectory.read(path)


def test_damage_is_told_with_its_dataset(tmp_path: Path) -> None:
    short = _written(tmp_path / "short.hdf5")
    with h5py.File(short, "r+") as file:
        file["action/ee_joint_states"].resize(2, axis=0)
        file["vision/cam_head/colors"][1] = np.frombuffer(b"no image", np.uint8)
    with pytest.raises(TrajectoryError, match=r"ee_joint_states has 2 steps and \S+ 3"):
        len(trajectory.read(short))
    found = trajectory.open_folder(short)[0]
    with pytest.raises(TrajectoryError, match="vision/cam_head/colors, step 1"):
        found.image("cam_head", 1)
    with h5py.File(tmp_path / "act.hdf5", "w") as file:
        file["observations/qpos"] = np.zeros((3, 14))
    with pytest.raises(TrajectoryError, match="neither `state` nor `action`"):
        len(trajectory.read(tmp_path / "act.hdf5"))


def test_without_h5py_one_sentence_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = _written(tmp_path / "a.hdf5")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(ImportError, match="pip install h5py"):
        trajectory.read(path)
    with pytest.raises(ImportError, match="pip install h5py"):
        Writer(tmp_path / "b.hdf5")
