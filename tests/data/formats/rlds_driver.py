"""What runs in a Python that has tensorflow-datasets: it writes RLDS as DROID has it, and reads it by our reader.

`write FOLDER NPZ`, `read FOLDER NPZ SET`. Numbers and images travel as NPZ; `read` converts to LeRobot as well.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

HEIGHT, WIDTH, EPISODES = 36, 64, 5
STEPS = {"action": 7, "observation/cartesian_position": 6, "observation/gripper_position": 1}
CAMERAS = ("exterior_image_1_left", "wrist_image_left")


def image(step: int) -> np.ndarray:
    """Return a smooth image that moves."""
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    return np.stack([255 - rows * 3, columns * 2 + step, rows * 3], -1).clip(0, 255).astype(np.uint8)


def episodes(kept: dict[str, np.ndarray]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the episodes, and keep their numbers."""
    draw = np.random.default_rng(3)
    for index in range(EPISODES):
        length = 4 + index
        # Its files have 32 bits for each number, whatever the features say.
        rows = {n: draw.normal(size=(length, width)).astype("f4").astype("f8") for n, width in STEPS.items()}
        kept.update({f"{index}/{name}": values for name, values in rows.items()})
        steps = [
            {
                "observation": {
                    **{camera: image(step + 40 * place) for place, camera in enumerate(CAMERAS)},
                    **{name.partition("/")[2]: rows[name][step] for name in STEPS if "/" in name},
                },
                "action": rows["action"][step],
                "is_last": step == length - 1,
                "reward": float(step == length - 1),
                "language_instruction": "put the pen in the cup",
                "language_instruction_2": "pen into cup" if index % 2 else "",
            }
            for step in range(length)
        ]
        yield f"{index}", {"steps": steps, "episode_metadata": {"file_path": f"/raw/{index}"}}


def write(folder: str, target: str) -> None:
    """Write a set of two shards by tensorflow-datasets' own builder."""
    import tensorflow_datasets as tfds

    of = tfds.features
    pictures = {camera: of.Image(shape=(HEIGHT, WIDTH, 3), encoding_format="jpeg") for camera in CAMERAS}
    numbers = {name: of.Tensor(shape=(width,), dtype=np.float64) for name, width in STEPS.items()}
    step = {
        "observation": {**pictures, **{n.partition("/")[2]: f for n, f in numbers.items() if "/" in n}},
        "action": numbers["action"],
        "is_last": of.Scalar(dtype=np.bool_),
        "reward": of.Scalar(dtype=np.float32),
        "language_instruction": of.Text(),
        "language_instruction_2": of.Text(),
    }
    features = of.FeaturesDict({"steps": of.Dataset(step), "episode_metadata": {"file_path": of.Text()}})
    kept: dict[str, np.ndarray] = {}
    tfds.dataset_builders.store_as_tfds_dataset(
        "droid_small",
        "1.0.0",
        features=features,
        split_datasets={"train": episodes(kept)},
        data_dir=folder,
        download_config=tfds.download.DownloadConfig(num_shards=2),
    )
    np.savez(target, **kept)


def read(folder: str, target: str, builder: str) -> None:
    """Save what our reader says, its episodes from the last to the first, and convert the set."""
    from xpl_cli.basics.progress import Progress
    from xpl_cli.data.conversion import job
    from xpl_cli.data.formats.writing import WriteOptions
    from xpl_cli.data.reading import open_set

    dataset = open_set(folder)
    kept: dict[str, Any] = {}
    for index in reversed(range(len(dataset))):
        episode = dataset[index]
        told = episode.extras["episode_metadata/file_path"]
        kept |= {f"{told}/{name}": episode.read(name) for name in episode.columns}
        kept |= {f"{told}/{name}": np.stack(list(episode.frames(name))) for name in episode.cameras}
        kept[f"{told}/told"] = np.array(episode.instructions)
        kept[f"{told}/length"] = np.array(episode.length)
    np.savez(target, **{name.removeprefix("/raw/"): value for name, value in kept.items()})
    options = WriteOptions(images="png")
    job.convert(
        job.ConversionJob(Path(folder), Path(builder), "lerobot-v3.0", rate_hz=15.0, options=options), Progress()
    )


if __name__ == "__main__":
    {"write": write, "read": read}[sys.argv[1]](*sys.argv[2:])
