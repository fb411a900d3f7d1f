"""Validation of trajectory files against their schema: names, shapes and types of datasets, and that images decode.

Only headers are read, and the first, middle and last encoded image of each camera.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl import _spec as sdk
from xpl import image_codec, json_text, trajectory
from xpl.observation import ObservationError
from xpl.trajectory import image_datasets, names, storage
from xpl_cli.data.sets.errors import DataError
from xpl_cli.standard.problems import Problem
from xpl_cli.standard.validate import page_of, validate

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from xpl.trajectory.hdf5_types import HDF5Dataset

SCHEMA: Final = "trajectory"
_JSON: Final = (sdk.Trajectory.INSTRUCTIONS, sdk.Trajectory.SUBTASKS)
_SERIES: Final = (sdk.Trajectory.STATE, sdk.Trajectory.ACTION)


def schema_problems(file: Path) -> list[Problem]:
    """Return the schema violations of a trajectory file, each with its dataset; none means that it is valid.

    Args:
        file: the trajectory.

    Raises:
        DataError: the file cannot be read.
    """
    try:
        with trajectory.read(file) as recording:
            problems = [*_of_schema(recording.datasets), *_of_series(recording.datasets), *_of_images(recording)]
    except (trajectory.TrajectoryError, ImportError) as error:
        raise DataError(str(error)) from None
    placed = (replace(one, file=str(file), page=page_of(SCHEMA)) for one in problems)
    return sorted(placed, key=lambda one: [str(part) for part in one.path])


def _of_schema(datasets: Mapping[names.DatasetPath, HDF5Dataset]) -> Iterator[Problem]:
    document: dict[str, Any] = {}
    for path, dataset in datasets.items():
        *groups, leaf = path
        inner = document
        for name in groups:
            inner = inner.setdefault(name, {})
        inner[leaf] = _schema_value(path, dataset)
    for problem in validate(document, SCHEMA):
        yield replace(problem, path=tuple(["/".join(map(str, problem.path))] if problem.path else ()))


def _of_series(datasets: Mapping[names.DatasetPath, HDF5Dataset]) -> Iterator[Problem]:
    """Yield a problem for state and action if none of its names is the standard's; the schema allows any name."""
    stems = {
        prefix + stored
        for prefixes in sdk.ARM_PREFIXES.values()
        for prefix in prefixes
        for stored in sdk.TRAJECTORY_STATE.values()
    }
    for group in _SERIES:
        there = [path[1] for path in datasets if path[0] == group and len(path) > 1]
        if there and not stems.intersection(there):
            expected = ", ".join(sdk.TRAJECTORY_STATE.values())
            message = f"no name is the standard's: expected some of {expected}, for two arms with left_ and right_"
            yield Problem((group,), f"{message}; got {', '.join(there[:9])}", expected=expected, got=", ".join(there))


def _of_images(recording: trajectory.Trajectory) -> Iterator[Problem]:
    """Yield a problem for each camera with a wrong number of images, or with data that is no image."""
    lengths = {path: data.shape[0] for path, data in recording.datasets.items() if names.is_series(path) and data.ndim}
    steps = next(iter(lengths.values()), None)
    for path, dataset in recording.datasets.items():
        if not names.is_image(path, sdk.Camera.COLOR) or not storage.is_encoded(dataset):
            continue
        path_of_problem, count = ("/".join(path),), dataset.shape[0]
        if steps is not None and count != steps:
            yield Problem(
                path_of_problem,
                f"expected {steps} images, as many as there are steps, got {count}",
                str(steps),
                str(count),
            )
        for step in sorted({0, count // 2, count - 1}) if count else ():
            try:
                image_codec.size_of(image_datasets.read_row(dataset, step))
            except (ObservationError, trajectory.TrajectoryError) as error:
                yield Problem(
                    path_of_problem, f"expected an encoded image at step {step}, got none: {error}", "an encoded image"
                )
                break


def _schema_value(path: names.DatasetPath, dataset: HDF5Dataset) -> Any:
    """Return a placeholder of the dataset's shape and type; the content only of strings and scalars."""
    if storage.hdf5().check_string_dtype(dataset.dtype) is not None and dataset.ndim == 0:
        text = str(storage.text(dataset))
        return _parsed(text) if path[0] in _JSON and len(path) == 1 else text
    if storage.is_encoded(dataset) and names.is_image(path, sdk.Camera.COLOR) and dataset.dtype.kind in "SO":
        return [np.zeros(1, np.uint8)] * min(dataset.shape[0], 2)
    if dataset.dtype.kind in "biuf":
        if dataset.shape:
            return np.broadcast_to(np.zeros((), dataset.dtype), dataset.shape)
        value = dataset[()]
        return value if np.isfinite(value) else str(value)  # NaN would pass any bound of a schema
    if storage.hdf5().check_string_dtype(dataset.dtype) is not None and dataset.ndim == 1:
        return storage.text(dataset)
    return f"{dataset.shape} {dataset.dtype}"


def _parsed(text: str) -> Any:
    try:
        return json_text.parse(text)
    except json_text.JsonError:
        return text
