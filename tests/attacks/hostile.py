"""Hostile files, generated: honest files of any format, changed in their structure or in their bytes."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from hypothesis import strategies as st

Draw = Callable[[st.SearchStrategy[Any]], Any]

DEEP = [0]
for _ in range(100):
    DEEP = [DEEP]
VALUES: list[Any] = [
    *(None, True, -1, 0, 1.5, 10**30, 10**400, 1e300, float("nan"), float("inf")),
    *("", "x", "../..", "/etc/passwd", "a/../b", "\0", "\x1b[31m", "\ud800", "<b>", "x" * 5000, "{episode_index}" * 9),
    *([], {}, [[]], [None], {"": None}, {"x": {}}, [1, "a"], DEEP),
]
ARRAYS: list[Any] = [
    np.float32(1),
    np.zeros(0, "f4"),
    np.zeros((0, 7), "f4"),
    np.zeros((3, 1, 1, 1, 2), "u1"),
    np.full((5, 7), np.nan),
    np.zeros((5, 2), "c16"),
    np.zeros(5, [("x", "f4"), ("y", "i8")]),
    np.array([b"\xff\xfe", b"x"], "S4"),
    b"\xff\xfe",
    "[" * 5000,
    '{"a": NaN}',
    h5py.Empty("f4"),
    np.arange(5, dtype="u8") << 60,
]


def places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every container in a document with each of its keys."""
    for key in list(value) if isinstance(value, dict) else range(len(value)):
        yield value, key
        if isinstance(value[key], (dict, list)):
            yield from places(value[key])


def document(draw: Draw, value: Any) -> Any:
    """Return a JSON document with one to three values replaced, left out or doubled."""
    value = json.loads(json.dumps([value]))
    for _ in range(draw(st.integers(1, 3))):
        container, key = draw(st.sampled_from(list(places(value))))
        deed = draw(st.sampled_from(["put", "put", "put", "drop", "rename"]))
        if deed == "put" or (container is value):
            container[key] = json.loads(json.dumps(draw(st.sampled_from(VALUES))))
        elif deed == "drop" or isinstance(container, list):
            container.pop(key)
        else:
            container["renamed"] = container.pop(key)
    return value[0] if value else None


def _json(draw: Draw, file: Path) -> None:
    file.write_text(json.dumps(document(draw, json.loads(file.read_bytes()))))


def _lines(draw: Draw, file: Path) -> None:
    lines = file.read_text().splitlines() or ["{}"]
    place = draw(st.integers(0, len(lines) - 1))
    lines[place] = json.dumps(document(draw, json.loads(lines[place])))
    file.write_text("\n".join(lines) + draw(st.sampled_from(["\n", "", "\n\n", "\n{"])))


def _hdf5(draw: Draw, file: Path) -> None:
    with h5py.File(file, "a") as opened:
        names: list[str] = []
        opened.visit(names.append)
        if not names:
            return
        for _ in range(draw(st.integers(1, 3))):
            name = draw(st.sampled_from(names))
            deed = draw(st.sampled_from(["drop", "array", "array", "group", "link", "attribute", "shorter", "claim"]))
            if name not in opened:
                continue
            there = opened[name]
            if deed == "attribute":
                holder = draw(st.sampled_from([opened, there]))
                key = draw(st.sampled_from([*holder.attrs, "fps", "instruction"]))
                holder.attrs[key] = draw(st.sampled_from(ARRAYS))
                continue
            is_shorter = deed == "shorter" and isinstance(there, h5py.Dataset) and there.ndim and there.nbytes < 1 << 24
            rows = there[()] if is_shorter else None
            del opened[name]
            if deed == "array":
                opened[name] = draw(st.sampled_from(ARRAYS))
            elif deed == "group":
                opened.create_group(name)
            elif deed == "link":
                target = draw(st.sampled_from(["/", "/nowhere", name, *names]))
                opened[name] = draw(st.sampled_from([h5py.SoftLink(target), h5py.ExternalLink("/etc/passwd", target)]))
            elif deed == "shorter" and rows is not None:
                opened[name] = rows[: draw(st.integers(0, len(rows)))]
            elif deed == "claim":
                shape = (1 << draw(st.integers(0, 50)), draw(st.sampled_from([1, 7, 1 << 12])))
                opened.create_dataset(name, shape, draw(st.sampled_from(["f4", "u1", "S9"])), chunks=(1, shape[1]))


def _parquet(draw: Draw, file: Path) -> None:
    table = pq.read_table(file)
    name = draw(st.sampled_from(table.column_names))
    place, rows = table.column_names.index(name), table.num_rows
    deed = draw(st.sampled_from(["drop", "nulls", "texts", "large", "ragged", "none", "nested", "twice"]))
    if deed == "drop":
        table = table.drop([name])
    elif deed == "none":
        table = table.slice(0, 0)
    elif deed == "twice":
        table = pa.Table.from_arrays([*table.columns, table.column(name)], names=[*table.column_names, name])
    else:
        values: list[Any] = {
            "nulls": [None] * rows,
            "texts": ["\0<b>"] * rows,
            "large": [2**62] * rows,
            "ragged": [[1.0] * (number % 3) for number in range(rows)],
            "nested": [{"a": [[number]]} for number in range(rows)],
        }[deed]
        table = table.set_column(place, name, pa.array(values))
    pq.write_table(table, file)


def _safetensors(draw: Draw, file: Path) -> None:
    data = file.read_bytes()
    (size,) = struct.unpack_from("<Q", data)
    header = json.dumps(document(draw, json.loads(data[8 : 8 + size]))).encode()
    length = draw(st.sampled_from([len(header), len(header), len(header) + 1, 2**63]))
    file.write_bytes(struct.pack("<Q", length) + header + data[8 + size :])


def _bytes(draw: Draw, file: Path) -> None:
    data = bytearray(file.read_bytes())
    for _ in range(draw(st.integers(1, 20))):
        if data:
            data[draw(st.integers(0, len(data) - 1))] = draw(st.integers(0, 255))
    file.write_bytes(data[: draw(st.sampled_from([len(data), len(data), len(data) // 2, 9, 0]))])


def _kind(draw: Draw, file: Path) -> None:
    """Put something else in the place of a file."""
    others = [other for other in file.parent.iterdir() if other.is_file()]
    content = draw(st.sampled_from(others)).read_bytes()
    file.unlink()
    deed = draw(st.sampled_from(["nothing", "folder", "pipe", "itself", "another", "elsewhere"]))
    if deed == "folder":
        file.mkdir()
    elif deed == "pipe":
        os.mkfifo(file)
    elif deed == "itself":
        file.symlink_to(file.name)
    elif deed == "another":
        file.write_bytes(content)
    elif deed == "elsewhere":
        file.symlink_to("/etc/passwd")


STRUCTURES: dict[str, Callable[[Draw, Path], None]] = {
    ".json": _json,
    ".zarray": _json,
    ".zgroup": _json,
    ".zattrs": _json,
    ".jsonl": _lines,
    ".hdf5": _hdf5,
    ".h5": _hdf5,
    ".parquet": _parquet,
    ".safetensors": _safetensors,
}


def damage(draw: Draw, folder: Path) -> None:
    """Change one or two files of a folder, or the file that it is."""
    for _ in range(draw(st.integers(1, 2))):
        files = sorted(path for path in [folder, *folder.rglob("*")] if path.is_file() and not path.is_symlink())
        if not files:
            return
        suffixes = sorted({path.suffix or path.name for path in files})
        suffix = draw(st.sampled_from(suffixes))
        file = draw(st.sampled_from([path for path in files if (path.suffix or path.name) == suffix]))
        structure = STRUCTURES.get(suffix, _bytes)
        deed = draw(st.sampled_from([structure, structure, structure, _bytes, _kind]))
        try:
            deed(draw, file)
        except (ValueError, OSError, KeyError, RuntimeError, TypeError, pa.ArrowException, struct.error):
            _bytes(draw, file)  # it was damaged already, so that its structure is none
