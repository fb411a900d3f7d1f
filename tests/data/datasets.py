"""Small sets of demonstrations in the forms of the field, with known contents."""

from __future__ import annotations

import io
import json
from typing import TYPE_CHECKING, Any

import av
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zarr
from PIL import Image

if TYPE_CHECKING:
    from pathlib import Path

SIZE = 64
SENTENCE = "pick up the bowl"


def picture(step: int, height: int = SIZE, width: int = SIZE) -> np.ndarray:
    """Return a smooth image whose top is red, whose bottom is blue, and that moves."""
    rows, columns = np.mgrid[0:height, 0:width]
    red = 255 - rows * 3
    return np.clip(np.stack([red, columns * 2 + step * 4, rows * 3], -1), 0, 255).astype(np.uint8)


def libero(path: Path, episodes: int = 3) -> Path:
    """Write LIBERO's form: numbers drawn from one seed, images upside down."""
    draw = np.random.default_rng(3)
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["problem_info"] = json.dumps({"language_instruction": SENTENCE.split()})
        data.attrs["env_args"] = json.dumps({"env_kwargs": {"control_freq": 20, "robots": ["Panda"]}})
        for index in range(episodes):
            steps = 8 + index
            group = data.create_group(f"demo_{index}")
            group.attrs["num_samples"] = steps
            group.attrs["init_state"] = np.arange(3.0)
            moves = draw.uniform(-1, 1, (steps, 6))
            group["actions"] = np.concatenate([moves, draw.choice([-1.0, 1.0], (steps, 1))], 1)
            opening = draw.uniform(0, 0.04, (steps, 1))
            group["obs/joint_states"] = draw.normal(size=(steps, 7))
            group["obs/gripper_states"] = np.concatenate([opening, -opening], 1)
            group["obs/ee_states"] = draw.uniform(-1, 1, (steps, 6))
            group["dones"] = np.arange(steps, dtype=np.uint8) == steps - 1
            for camera in ("agentview_rgb", "eye_in_hand_rgb"):
                group[f"obs/{camera}"] = np.stack([picture(step)[::-1] for step in range(steps)])
    return path


def robotwin(folder: Path) -> Path:
    """Write RoboTwin's form: JPEGs with red and blue exchanged, sentences beside."""
    draw = np.random.default_rng(4)
    (folder / "data").mkdir(parents=True)
    (folder / "instructions").mkdir()
    with h5py.File(folder / "data" / "episode0.hdf5", "w") as file:
        vector = draw.normal(size=(6, 14))
        vector[:, [6, 13]] = draw.uniform(0, 1, (6, 2))
        file["joint_action/vector"] = vector
        for side, first in (("left", 0), ("right", 7)):
            file[f"joint_action/{side}_arm"] = vector[:, first : first + 6]
            file[f"joint_action/{side}_gripper"] = vector[:, first + 6]
        rows = [jpeg(picture(step)[..., ::-1]) for step in range(6)]
        file.create_dataset("observation/head_camera/rgb", data=rows, dtype=f"S{max(map(len, rows))}")
        file["observation/head_camera/intrinsic_cv"] = np.tile(np.eye(3), (6, 1, 1))
    instructions = {"seen": ["stack them", "pile them up"], "unseen": ["build a tower"]}
    (folder / "instructions" / "episode0.json").write_text(json.dumps(instructions), encoding="utf-8")
    return folder


def aloha(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Write ACT's form, one camera raw and one as JPEGs in rows of one length; return positions, actions and images."""
    draw = np.random.default_rng(7)
    qpos, action = draw.normal(size=(4, 14)), draw.normal(size=(4, 14))
    frames = np.stack([picture(step) for step in range(4)])
    rows = [jpeg(frame) for frame in frames]
    padded = np.zeros((4, max(map(len, rows))), np.uint8)
    for step, row in enumerate(rows):
        padded[step, : len(row)] = np.frombuffer(row, np.uint8)
    with h5py.File(path, "w") as file:
        file.attrs["sim"], file.attrs["fps"], file.attrs["language_instruction"] = True, 50, SENTENCE
        file["observations/qpos"], file["action"] = qpos, action
        file["observations/images/top"], file["observations/images/wrist"] = frames, padded
    return qpos, action, frames


def standard(path: Path) -> None:
    """Write the standard's form, as RoboDojo has it."""
    draw = np.random.default_rng(8)
    with h5py.File(path, "w") as file:
        for group in ("state", "action"):
            file[f"{group}/left_arm_joint_states"] = draw.normal(size=(4, 6))
        file["vision/cam_head/colors"] = np.stack([picture(step) for step in range(4)])
        file["instruction"] = SENTENCE


def diffusion_policy(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Write Diffusion Policy's form, two episodes of four and five steps; return actions and images."""
    draw = np.random.default_rng(9)
    action = draw.normal(size=(9, 2)).astype(np.float32)
    images = np.stack([picture(step) for step in range(9)])
    store = zarr.open_group(str(path), mode="w", zarr_format=2)
    data, meta = store.require_group("data"), store.require_group("meta")
    data.create_array("action", data=action, chunks=(9, 2))
    data.create_array("img", data=images, chunks=(1, *images.shape[1:]))
    data.create_array("img_float", data=images.astype(np.float32), chunks=(1, *images.shape[1:]))
    meta.create_array("episode_ends", data=np.array([4, 9]), chunks=(2,))
    return action, images


def lerobot_v21(root: Path, episodes: int = 3) -> Path:
    """Write LeRobot v2.1 as its own recorder lays it out: a table and a video for each episode, lists as JSON lines."""
    draw = np.random.default_rng(6)
    camera = "observation.images.top"
    numbers = {"observation.state": 7, "action": 7}
    listed, statistics = [], []
    first = 0
    for index in range(episodes):
        steps = np.arange(5 + index)
        rows = {name: draw.normal(size=(len(steps), width)).astype(np.float32) for name, width in numbers.items()}
        counted = {
            "timestamp": (steps / 10).astype(np.float32),
            "frame_index": steps,
            "episode_index": np.full(len(steps), index),
            "index": first + steps,
            "task_index": np.zeros(len(steps), np.int64),
        }
        first += len(steps)
        columns = {name: pa.FixedSizeListArray.from_arrays(values.ravel(), 7) for name, values in rows.items()}
        table = root / "data/chunk-000" / f"episode_{index:06d}.parquet"
        table.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table({**columns, **{name: pa.array(values) for name, values in counted.items()}}), table)
        video = root / "videos/chunk-000" / camera / f"episode_{index:06d}.mp4"
        video.parent.mkdir(parents=True, exist_ok=True)
        _mp4(video, [picture(step) for step in steps], 10)
        listed.append({"episode_index": index, "tasks": [SENTENCE], "length": len(steps)})
        episode_lines = {"min": [0.0], "max": [1.0], "mean": [0.5], "std": [0.1], "count": [len(steps)]}
        seen = {key: value if key == "count" else [[value]] * 3 for key, value in episode_lines.items()}
        statistics.append({"episode_index": index, "stats": {camera: seen}})
    features = {name: {"dtype": "float32", "shape": [width], "names": None} for name, width in numbers.items()}
    features[camera] = {"dtype": "video", "shape": [SIZE, SIZE, 3], "names": ["height", "width", "channels"]}
    features[camera]["info"] = {"video.codec": "h264", "video.fps": 10}
    features |= {name: {"dtype": str(v.dtype), "shape": [1], "names": None} for name, v in counted.items()}
    info = {
        "codebase_version": "v2.1",
        "robot_type": "panda",
        "fps": 10,
        "chunks_size": 1000,
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
        "features": features,
    }
    (root / "meta").mkdir()
    (root / "meta" / "info.json").write_text(json.dumps(info), encoding="utf-8")
    for name, lines in (("episodes", listed), ("episodes_stats", statistics)):
        text = "".join(json.dumps(line) + "\n" for line in lines)
        (root / "meta" / f"{name}.jsonl").write_text(text, encoding="utf-8")
    return root


def lerobot_v30(root: Path) -> tuple[np.ndarray, np.ndarray]:
    """Write LeRobot v3.0 as its own recorder lays it out: two episodes in one table and one video, images in the table.

    Return actions and images of all steps.
    """
    video, image = "observation.images.top", "observation.images.wrist"
    lengths = (4, 6)
    total = sum(lengths)
    actions = np.random.default_rng(10).normal(size=(total, 7)).astype(np.float32)
    frames = np.stack([picture(step) for step in range(total)])
    steps = np.concatenate([np.arange(length) for length in lengths])
    episodes = np.repeat(np.arange(len(lengths)), lengths)
    encoded = [{"bytes": png(frame), "path": f"frame-{step:06d}.png"} for step, frame in enumerate(frames)]
    columns = {
        "action": pa.FixedSizeListArray.from_arrays(actions.ravel(), 7),
        image: pa.array(encoded, pa.struct([("bytes", pa.binary()), ("path", pa.string())])),
        "timestamp": pa.array((steps / 10).astype(np.float32)),
        "frame_index": pa.array(steps),
        "episode_index": pa.array(episodes),
        "index": pa.array(np.arange(total)),
        "task_index": pa.array(np.zeros(total, np.int64)),
    }
    _parquet(root / "data/chunk-000/file-000.parquet", columns)
    ends = np.cumsum(lengths)
    rows: dict[str, Any] = {
        "episode_index": [0, 1],
        "tasks": [[SENTENCE], [SENTENCE]],
        "length": list(lengths),
        "dataset_from_index": ends - lengths,
        "dataset_to_index": ends,
        f"videos/{video}/from_timestamp": (ends - lengths) / 10,
        f"videos/{video}/to_timestamp": ends / 10,
    }
    for location in ("data", f"videos/{video}", "meta/episodes"):
        rows |= {f"{location}/chunk_index": [0, 0], f"{location}/file_index": [0, 0]}
    _parquet(root / "meta/episodes/chunk-000/file-000.parquet", rows)
    _parquet(root / "meta/tasks.parquet", {"task_index": [0], "__index_level_0__": [SENTENCE]})
    path = root / "videos" / video / "chunk-000/file-000.mp4"
    path.parent.mkdir(parents=True)
    _mp4(path, list(frames), 10)
    features: dict[str, Any] = {
        name: {"dtype": str(column.type).replace("float", "float32"), "shape": [1], "names": None}
        for name, column in columns.items()
    }
    features["action"] = {"dtype": "float32", "shape": [7], "names": [f"joint_{index}" for index in range(7)]}
    for name, dtype in ((image, "image"), (video, "video")):
        features[name] = {"dtype": dtype, "shape": [SIZE, SIZE, 3], "names": ["height", "width", "channels"]}
    info = {
        "codebase_version": "v3.0",
        "robot_type": "panda",
        "fps": 10,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "features": features,
    }
    (root / "meta" / "info.json").write_text(json.dumps(info), encoding="utf-8")
    return actions, frames


def _parquet(path: Path, columns: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table({name: pa.array(values) for name, values in columns.items()}), path)


def _mp4(path: Path, frames: list[np.ndarray], rate: int) -> None:
    with av.open(str(path), "w") as output:
        stream = output.add_stream("libx264", rate, options={"g": "2", "bf": "0"})
        stream.height, stream.width, stream.pix_fmt = *frames[0].shape[:2], "yuv420p"
        for frame in frames:
            output.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        output.mux(stream.encode(None))


def png(image: np.ndarray) -> bytes:
    """Return a PNG."""
    target = io.BytesIO()
    Image.fromarray(image).save(target, "PNG")
    return target.getvalue()


def jpeg(image: np.ndarray) -> bytes:
    """Return a JPEG without any mark."""
    target = io.BytesIO()
    Image.fromarray(image).save(target, "JPEG", quality=95)
    return target.getvalue()


def numbers(episode: Any) -> dict[str, np.ndarray]:
    """Return all columns of an episode."""
    return {name: episode.read(name) for name in episode.columns}


def same(one: Any, other: Any) -> None:
    """Hold two episodes against each other: names, types and numbers are the same."""
    assert dict(one.columns) == dict(other.columns)
    for name, rows in numbers(one).items():
        np.testing.assert_array_equal(rows, other.read(name), err_msg=name)
    assert set(one.cameras) == set(other.cameras)
    assert (one.length, one.instructions) == (other.length, other.instructions)
