"""Recorded episodes in the standard's HDF5 form (`spec/v1/trajectory.schema.json`): written, and read lazily.

    with trajectory.Writer("demos/episode_0000000.hdf5") as episode:
        episode.add(obs, action)                # once for each control step

    for episode in trajectory.open_folder("demos"):
        for obs, action in episode:             # as a policy would get them
            ...

Needs h5py, and Pillow where images are encoded (extra `data`); both are imported when they are needed.
"""

from __future__ import annotations

from xpl.trajectory.errors import TrajectoryError
from xpl.trajectory.folder import Folder, open_files, open_folder
from xpl.trajectory.pictures import Picture
from xpl.trajectory.reading import Trajectory, read
from xpl.trajectory.writing import FORMS, Writer

__all__ = ["FORMS", "Folder", "Picture", "Trajectory", "TrajectoryError", "Writer", "open_files", "open_folder", "read"]
