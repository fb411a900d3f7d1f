"""What LeRobot itself does with sets, in its own Python.

`read ROOT NPZ`, `write ROOT NPZ`, `port HDF5 ROOT`. Numbers and images travel as NPZ. The last one prints how many
seconds LeRobot took, without its imports.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from typing import Any

import av
import numpy as np
import torch
import torchvision
from lerobot.datasets.lerobot_dataset import LeRobotDataset

NAME = "local/set"


class VideoReader:
    """torchvision's reader of videos, which releases since 0.24 have no more and LeRobot 0.4 asks for: over PyAV."""

    def __init__(self, path: str, _stream: str) -> None:
        self.container = av.open(path)
        self._stream = self.container.streams.video[0]

    def seek(self, time_s: float, keyframes_only: bool = False) -> VideoReader:
        """Go to the frame that stands for itself at or before a time."""
        self.container.seek(max(0, int(time_s / self._stream.time_base)), stream=self._stream)
        return self

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """Yield frames with their times."""
        for frame in self.container.decode(self._stream):
            data = torch.from_numpy(frame.to_ndarray(format="rgb24")).permute(2, 0, 1)
            yield {"data": data, "pts": float(frame.time)}


def read(root: str, target: str) -> None:
    """Save every item of a set."""
    if not hasattr(torchvision.io, "VideoReader"):
        torchvision.io.VideoReader = VideoReader
        torchvision.set_video_backend = lambda _backend: None
    result = LeRobotDataset(NAME, root=root, video_backend="pyav")
    items = [result[index] for index in range(len(result))]
    arrays = {key: np.stack([item[key].numpy() for item in items]) for key in items[0] if key != "task"}
    np.savez(target, tasks=np.array([item["task"] for item in items]), **arrays)


def write(root: str, target: str) -> None:
    """Make a small set as LeRobot's recorder does."""
    draw = np.random.default_rng(5)
    features = {
        "observation.state": {"dtype": "float32", "shape": (7,), "names": [f"joint_{index}" for index in range(7)]},
        "action": {"dtype": "float32", "shape": (7,), "names": None},
        "force": {"dtype": "float64", "shape": (2, 3), "names": None},
        "observation.images.top": {"dtype": "video", "shape": (64, 96, 3), "names": ["height", "width", "channels"]},
        "observation.images.wrist": {"dtype": "image", "shape": (48, 64, 3), "names": ["height", "width", "channels"]},
    }
    dataset = LeRobotDataset.create(NAME, fps=20, features=features, root=root, robot_type="panda")
    rows, columns = np.mgrid[0:64, 0:96]
    kept: dict[str, list[np.ndarray]] = {}
    for episode in range(3):
        for step in range(6 + episode):
            image = np.stack([255 - rows * 3, columns * 2 + step, rows * 3], -1).clip(0, 255).astype(np.uint8)
            frame = {
                "observation.state": draw.normal(size=7).astype(np.float32),
                "action": draw.normal(size=7).astype(np.float32),
                "force": draw.normal(size=(2, 3)),
                "observation.images.top": image,
                "observation.images.wrist": image[:48, :64],
            }
            for key, value in frame.items():
                kept.setdefault(f"{episode}/{key}", []).append(value)
            dataset.add_frame({**frame, "task": ("pick", "place")[episode % 2]})
        dataset.save_episode()
    dataset.finalize()
    np.savez(target, **{key: np.stack(values) for key, values in kept.items()})


def port(source: str, root: str) -> None:
    """Make a set of robomimic's HDF5 as scripts of the field do: frame by frame, by LeRobot's recorder."""
    import h5py

    with h5py.File(source) as file:
        first = file["data/demo_0"]
        cameras = [name for name in first["obs"] if first["obs"][name].ndim == 4]
        features = {
            "observation.state": {"dtype": "float64", "shape": (7,), "names": None},
            "action": {"dtype": "float64", "shape": (7,), "names": None},
        }
        for name in cameras:
            shape = first["obs"][name].shape[1:]
            features[f"observation.images.{name}"] = {
                "dtype": "video",
                "shape": shape,
                "names": ["height", "width", "channels"],
            }
        begins = time.perf_counter()
        dataset = LeRobotDataset.create(NAME, fps=20, features=features, root=root, image_writer_threads=4)
        for index in range(len(file["data"])):
            group = file[f"data/demo_{index}"]
            columns = {"observation.state": group["obs/joint_states"][:], "action": group["actions"][:]}
            columns |= {f"observation.images.{name}": group["obs"][name] for name in cameras}
            for step in range(len(columns["action"])):
                dataset.add_frame({**{key: rows[step] for key, rows in columns.items()}, "task": "pick"})
            dataset.save_episode()
        dataset.finalize()
        sys.stdout.write(f"{time.perf_counter() - begins}\n")


if __name__ == "__main__":
    {"read": read, "write": write, "port": port}[sys.argv[1]](*sys.argv[2:])
