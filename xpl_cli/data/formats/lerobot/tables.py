"""Writing of LeRobot's parquet files, with the types and metadata that pandas and `datasets` expect."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl_cli.data.formats import libraries

if TYPE_CHECKING:
    from xpl_cli.data.formats.lerobot.layout import Feature
    from xpl_cli.data.formats.writing import WrittenEpisode


def schema(features: Mapping[str, Feature]) -> Any:
    """Return the arrow schema of info.json's features, without videos."""
    arrow = libraries.arrow()
    fields = [arrow.field(name, _type(feature)) for name, feature in features.items() if feature.dtype != "video"]
    return arrow.schema(fields)


def write(path: Path, types: Any, columns: Mapping[str, Any]) -> None:
    """Write the rows of one episode as one row group, columns in the order of `types`."""
    arrow = libraries.arrow()
    arrays = [_array(columns[field.name], field.type) for field in types]
    libraries.parquet().write_table(arrow.Table.from_arrays(arrays, schema=types), path, compression="snappy")


def join(path: Path, parts: list[Path]) -> None:
    """Concatenate parquet files; each keeps its row group."""
    parquet = libraries.parquet()
    writer = None
    try:
        for part in parts:
            table = parquet.read_table(part)
            writer = writer or parquet.ParquetWriter(path, table.schema, compression="snappy")
            writer.write_table(table)
    finally:
        if writer is not None:
            writer.close()


def write_tasks(path: Path, tasks: list[str]) -> None:
    """Write the table of tasks, with the instruction as pandas index."""
    arrow = libraries.arrow()
    index = "__index_level_0__"
    metadata = {
        "index_columns": [index],
        "column_indexes": [
            {
                "name": None,
                "field_name": None,
                "pandas_type": "unicode",
                "numpy_type": "object",
                "metadata": {"encoding": "UTF-8"},
            }
        ],
        "columns": [
            {
                "name": "task_index",
                "field_name": "task_index",
                "pandas_type": "int64",
                "numpy_type": "int64",
                "metadata": None,
            },
            {"name": None, "field_name": index, "pandas_type": "unicode", "numpy_type": "object", "metadata": None},
        ],
        "creator": {"library": "pyarrow", "version": arrow.__version__},
        "pandas_version": "2.0.0",
    }
    types = arrow.schema(
        [("task_index", arrow.int64()), (index, arrow.string())], metadata={"pandas": json.dumps(metadata)}
    )
    columns = [arrow.array(range(len(tasks)), arrow.int64()), arrow.array(tasks, arrow.string())]
    libraries.parquet().write_table(arrow.Table.from_arrays(columns, schema=types), path)


def write_episodes(path: Path, rows: list[dict[str, Any]], pieces: list[WrittenEpisode]) -> None:
    """Write the episode table: one row each, with statistics in columns `stats/<feature>/<name>`."""
    arrow = libraries.arrow()
    keys = list(dict.fromkeys(key for row in rows for key in row))
    columns: dict[str, list[Any]] = {key: [row.get(key) for row in rows] for key in keys}
    for feature, statistics in pieces[0].stats.items():
        for name in statistics:
            columns[f"stats/{feature}/{name}"] = [piece.stats[feature][name] for piece in pieces]
    path.parent.mkdir(parents=True, exist_ok=True)
    libraries.parquet().write_table(arrow.Table.from_pydict(columns), path, compression="snappy")


def _type(feature: Feature) -> Any:
    arrow = libraries.arrow()
    if feature.dtype == "image":
        return arrow.struct([("bytes", arrow.binary()), ("path", arrow.string())])
    if feature.dtype == "string":
        return arrow.string()
    plain = arrow.from_numpy_dtype(np.dtype(feature.dtype))
    if feature.shape == (1,):
        return plain
    if len(feature.shape) == 1:
        return arrow.list_(plain, feature.shape[0])
    for _ in feature.shape:
        plain = arrow.list_(plain)
    return plain


def _array(values: Any, kind: Any) -> Any:
    arrow = libraries.arrow()
    if not isinstance(values, np.ndarray):
        return arrow.array(values, kind)
    if values.dtype.kind in "UO":
        return arrow.array([str(value) for value in values.reshape(-1)], kind)
    flat = arrow.array(np.ascontiguousarray(values).reshape(-1))
    if arrow.types.is_fixed_size_list(kind):
        return arrow.FixedSizeListArray.from_arrays(flat, kind.list_size)
    if not arrow.types.is_list(kind):
        return flat
    for size in reversed(values.shape[1:]):
        offsets = arrow.array(np.arange(0, len(flat) + 1, size, dtype=np.int32))
        flat = arrow.ListArray.from_arrays(offsets, flat)
    return flat
