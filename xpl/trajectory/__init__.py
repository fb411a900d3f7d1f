"""Trajectories in the standard's HDF5 format (`spec/v1/trajectory.schema.json`): writing, and lazy reading.

    with trajectory.Writer("demos/episode_0000000.hdf5") as episode:
        episode.add(obs, action)                # once for each control step

    for episode in trajectory.open_folder("demos"):
        for obs, action in episode:             # as a policy would get them
            ...

Needs h5py, and Pillow for encoded images (extra `data`); both are imported on first use.
"""

from __future__ import annotations

from xpl.trajectory.errors import TrajectoryError
from xpl.trajectory.folder import Folder, open_files, open_folder
from xpl.trajectory.image_datasets import ImageSeries
from xpl.trajectory.reading import Trajectory, read
from xpl.trajectory.writing import FORMS, Writer

__all__ = [
    "FORMS",
    "Folder",
    "ImageSeries",
    "Trajectory",
    "TrajectoryError",
    "Writer",
    "open_files",
    "open_folder",
    "read",
]
