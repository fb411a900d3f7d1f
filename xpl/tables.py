"""Arrays in files of a training: JSON, NPZ without pickles, safetensors.

Files are untrusted input: sizes are checked before memory is allocated, and nothing is executed.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import json_text
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from pathlib import Path

SIZE_LIMIT = 64 * 2**20
"""Most bytes of a file, and of an unpacked array in it."""

_KINDS = {"F64": np.float64, "F32": np.float32, "F16": np.float16, "I64": np.int64, "I32": np.int32}


def find(file: str, folders: Sequence[Path]) -> Path | None:
    """Return the path of a file in the first folder that has it; None if none has."""
    return next((folder / file for folder in folders if (folder / file).is_file()), None)


def read(path: Path, key: Sequence[str]) -> Any:
    """Return the value of a key in a file: an array, or a JSON value.

    Args:
        path: file; the suffix is the format: .npz, .safetensors, otherwise JSON.
        key: path of the key; joined by / or by a dot in NPZ and safetensors.

    Raises:
        ConversionError: the file is too large, has another format, or no such key.
    """
    if path.stat().st_size > SIZE_LIMIT:
        raise ConversionError(
            f"{path} is larger than files of numbers may be: {path.stat().st_size} bytes, at most {SIZE_LIMIT}"
        )
    words = [word for word in key if word]
    if path.suffix == ".npz":
        return _npz(path, words)
    if path.suffix == ".safetensors":
        table = _safetensors(path)
        return table[_name(words, table, path)]
    return _entry(_document(path), words, path)


def names(path: Path) -> list[str]:
    """Return the names of a safetensors file's arrays.

    Raises:
        ConversionError: it is too large, or no safetensors file.
    """
    if path.stat().st_size > SIZE_LIMIT:
        raise ConversionError(f"{path} is larger than files of numbers may be: at most {SIZE_LIMIT} bytes")
    return sorted(_safetensors(path))


def _name(words: Sequence[str], names: Mapping[str, Any], path: Path) -> str:
    for joint in ("/", "."):
        if joint.join(words) in names:
            return joint.join(words)
    raise ConversionError(f"{path} has no {'/'.join(words)}; it has {', '.join(sorted(names))[:400]}")


def _npz(path: Path, words: Sequence[str]) -> np.ndarray:
    try:
        with zipfile.ZipFile(path) as archive:
            sizes = {entry.filename[: -len(".npy")]: entry.file_size for entry in archive.infolist()}
        name = _name(words, sizes, path)
        if sizes[name] > SIZE_LIMIT:
            raise ConversionError(f"{path}: {name} unpacks to {sizes[name]} bytes, at most {SIZE_LIMIT}")
        with np.load(path, allow_pickle=False) as opened:
            array: np.ndarray = opened[name]
    except (OSError, EOFError, MemoryError, ValueError, NotImplementedError, zipfile.BadZipFile, zlib.error) as error:
        if isinstance(error, ConversionError):
            raise
        raise ConversionError(f"{path} is not a file of numpy arrays: {error}") from None
    return array


def _document(path: Path) -> Any:
    try:
        return json_text.parse(path.read_bytes())
    except json_text.JsonError as error:
        raise ConversionError(f"{path}: {error}") from None


def _entry(document: object, words: Sequence[str], path: Path) -> Any:
    for word in words:
        if not isinstance(document, Mapping) or word not in document:
            found_keys = ", ".join(map(str, document)) if isinstance(document, Mapping) else type(document).__name__
            raise ConversionError(f"{path} has no {'/'.join(words)}: at {word!r} there is {found_keys[:400]}")
        document = document[word]
    return document


def _safetensors(path: Path) -> dict[str, np.ndarray]:
    """Read a safetensors file: eight bytes with the length of a JSON header, the header, the numbers."""
    data = path.read_bytes()
    try:
        (size,) = struct.unpack_from("<Q", data)
        header = json_text.parse(data[8 : 8 + size])
        body = memoryview(data)[8 + size :]
        return {
            name: np.frombuffer(body[slice(*entry["data_offsets"])], _KINDS[entry["dtype"]]).reshape(entry["shape"])
            for name, entry in header.items()
            if name != "__metadata__" and entry["dtype"] in _KINDS
        }
    except (AttributeError, OverflowError, ValueError, KeyError, TypeError, RecursionError, struct.error) as error:
        raise ConversionError(f"{path} is not a safetensors file: {error}") from None
