"""Reading of an untrusted checkpoint folder: bounded, inside the folder, and without running code.

No pickle is opened: of a `.pth` or `.ckpt` that is a ZIP only the members' names are listed. Every problem is a
`UserError` that names file and line.
"""

from __future__ import annotations

import json
import math
import os
import re
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import IO, Any, Final, TypeVar

from xpl import json_text
from xpl_cli.adopt.facts import Evidence
from xpl_cli.basics import files
from xpl_cli.basics.errors import UserError

_DOCUMENT: Final = 32 << 20
"""Most bytes of a JSON or YAML document; statistics of hundreds of datasets have ten million."""
_HEADER: Final = 64 << 20
"""Most bytes of the header of a safetensors file."""
_WEIGHTS: Final = 1 << 42
_TENSOR: Final = 1 << 20
"""Most bytes of a tensor that is read: statistics are vectors."""
_MEMBERS: Final = 20_000
_LISTED: Final = 40
_ENTRIES: Final = 20_000
"""Most entries of a folder that are listed."""
_MOST_NUMBERS: Final = 10_000
_LARGEST: Final = 1e15
"""Largest count, size or statistic that is accepted."""
_KINDS: Final = {"F64": "<f8", "F32": "<f4", "F16": "<f2", "I64": "<i8", "I32": "<i4", "U8": "u1", "BOOL": "?"}
_TOKEN: Final = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\]:,]')
_TYPE_NAMES: Final = {
    dict: "a map",
    list: "a list",
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "a flag",
}

Value = TypeVar("Value")
_MISSING: Final = object()


class ConfigDocument:
    """A JSON or YAML document with access by path and type.

    Args:
        file: its name in evidence.
        value: the parsed value.
        text: its text, for line numbers; "" if unknown.
        path: for errors.
    """

    def __init__(self, file: str, value: object, text: str = "", path: Path | None = None) -> None:
        self.file = file
        self.value = value
        self._text = text
        self._path = path or Path(file)

    def get(self, kind: type[Value], *path: str | int, default: Any = _MISSING) -> Value:
        """Return the value at a path.

        Args:
            kind: its type; an int is a float too.
            path: keys and indices.
            default: returned if the value is missing or null; without, that is an error.

        Raises:
            UserError: the value is missing, or has another type.
        """
        value = self.at(*path)
        if value is None and default is not _MISSING:
            return default  # type: ignore[no-any-return]
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        fits = isinstance(value, kind) and (kind is bool or not isinstance(value, bool))
        if kind is dict and fits and len(value) > _MOST_NUMBERS:
            raise UserError(
                f"{self.location()}: expected {_MOST_NUMBERS} entries at most at {'/'.join(map(str, path))}"
            )
        if kind in {int, float} and is_number:
            fits = (fits or kind is float) and _is_sane(value)
            value = float(value) if fits and kind is float else value
        if not fits:
            came = "nothing" if value is None else f"{str(value)[:60]!r}"
            location = "/".join(map(str, path)) or "the document"
            raise UserError(f"{self.location(*path)}: expected {_TYPE_NAMES[kind]} at {location}, got {came}")
        return value  # type: ignore[no-any-return]

    def at(self, *path: str | int) -> Any:
        """Return the value at a path, of any type; None if there is none."""
        value = self.value
        for key in path:
            if isinstance(value, Mapping) and key in value:
                value = value[key]
            elif isinstance(value, Sequence) and isinstance(key, int) and not isinstance(value, str):
                value = value[key] if -len(value) <= key < len(value) else None
            else:
                return None
        return value

    def numbers(self, *path: str | int) -> list[float] | None:
        """Return a list of finite numbers, nested lists flattened; None if there is no value.

        Raises:
            UserError: the value is something else, or has too many numbers.
        """
        value = self.at(*path)
        if value is None:
            return None
        flat = list(_flat(value, 0))
        if len(flat) > _MOST_NUMBERS or not all(
            isinstance(one, (int, float)) and not isinstance(one, bool) and _is_sane(one) for one in flat
        ):
            raise UserError(f"{self.location(*path)}: expected a list of finite numbers at {'/'.join(map(str, path))}")
        return [float(one) for one in flat]

    def texts(self, *path: str | int) -> list[str] | None:
        """Return a list of strings; None if the value is something else."""
        value = self.at(*path)
        fits = (
            isinstance(value, list) and 0 < len(value) <= _MOST_NUMBERS and all(isinstance(one, str) for one in value)
        )
        return value if fits else None

    def choose_entry(self, names: Iterable[object], requested: str | None) -> str:
        """Return the entry of statistics to use: the one that the user named, or the only one.

        Args:
            names: of the entries.
            requested: the user's choice; None for none.

        Raises:
            UserError: there is no entry of that name, or several without a choice; the message lists them.
        """
        entries = [str(name) for name in names]
        if requested in entries:
            return requested
        if len(entries) == 1 and requested is None:
            return entries[0]
        prefix = f"--statistics {requested}: " if requested else "statistics of several data sets or robots: "
        available = ", ".join(entries[:_LISTED]) or "none"
        hint = f"choose one with --statistics NAME, such as {entries[0]}" if entries else None
        raise UserError(f"{self.location()}: {prefix}there are {available}", hint=hint)

    def evidence_of(self, *path: str | int, what: str | None = None) -> Evidence:
        """Return the evidence for a value: its line, and the value itself."""
        text = what
        if text is None:
            value = self.at(*path)
            name = "/".join(map(str, path))
            text = f"{name}: {json.dumps(value, default=str)[:60]}" if not isinstance(value, Mapping) else name
        return Evidence(self.file, self.line(*path), text)

    def location(self, *path: str | int) -> str:
        """Return path and line of a value, for an error message."""
        line = self.line(*path)
        return str(self._path) if line is None else f"{self._path}:{line}"

    def line(self, *path: str | int) -> int | None:
        """Return the line of the last key of a path, from 1; None if unknown."""
        return self._lines.get(tuple(key for key in path if isinstance(key, str)))

    @cached_property
    def _lines(self) -> dict[tuple[str, ...], int]:
        """The line of each key, by its path of keys; the first one of several in a list."""
        lines: dict[tuple[str, ...], int] = {}
        above: list[str | None] = []
        key: str | None = None
        line, offset = 1, 0
        for token in _TOKEN.finditer(self._text):
            line += self._text.count("\n", offset, token.start())
            offset = token.start()
            text = token[0]
            if text in "{[":
                above.append(key)
                key = None
            elif text in "}]":
                key = above.pop() if above else None
            elif text[0] == '"' and self._text[token.end() : token.end() + 40].lstrip().startswith(":"):
                key = _unquoted(text)
                lines.setdefault((*(parent for parent in above if parent is not None), key), line)
        return lines


class CheckpointFolder:
    """An untrusted folder. Links may lead inside it, or to the blobs of the hub's cache that contains it.

    Args:
        path: the folder.
        label: how evidence names it, "" for file names alone.
    """

    def __init__(self, path: Path, label: str = "") -> None:
        self.path = path
        self.label = label
        self._root = path.resolve()
        # A snapshot in the hub's cache is links to the blobs two folders above.
        self._roots = (self._root, self._root.parents[1]) if self._root.parent.name == "snapshots" else (self._root,)

    def below(self, name: str) -> CheckpointFolder:
        """Return a folder in this one."""
        self._inside(self.path / name)
        return CheckpointFolder(self.path / name, self._name(name))

    def has(self, name: str) -> bool:
        """Tell whether there is a file or folder of this name."""
        try:
            return (self.path / name).exists()
        except OSError:
            return False

    def names(self, pattern: str) -> list[str]:
        """Return the names that match a pattern, relative to the folder, sorted.

        Raises:
            UserError: the folder has more entries than any checkpoint.
        """
        names: list[str] = []
        try:
            for count, entry in enumerate(self.path.glob(pattern)):
                if count >= _ENTRIES:
                    raise UserError(f"{self.path} holds more than {_ENTRIES} entries: expected one checkpoint")
                names.append(entry.relative_to(self.path).as_posix())
        except OSError as error:
            raise UserError(f"{self.path} cannot be read: {error.strerror or error}") from None
        return sorted(names)

    def json(self, name: str) -> ConfigDocument:
        """Return a JSON document.

        Raises:
            UserError: if it cannot be read, is too large, or is no JSON.
        """
        text = self._text(name)
        try:
            return ConfigDocument(self._name(name), json_text.parse(text), text, self.path / name)
        except json_text.JsonError as error:
            raise UserError(f"{self.path / name}: {error}") from None

    def yaml(self, name: str) -> ConfigDocument:
        """Return a YAML document of plain values; tags that name classes are refused.

        Raises:
            UserError: if it cannot be read, is too large, or is no YAML.
        """
        import yaml

        from xpl_cli.basics.yaml.text import parse

        text = self._text(name)
        try:
            return ConfigDocument(self._name(name), parse(text), "", self.path / name)
        except yaml.MarkedYAMLError as error:
            line = "" if error.problem_mark is None else f":{error.problem_mark.line + 1}"
            raise UserError(f"{self.path / name}{line} is not YAML: {error.problem}") from None

    def text(self, name: str) -> str:
        """Return the text of a file.

        Raises:
            UserError: if it cannot be read, is too large, or is not UTF-8.
        """
        return self._text(name)

    def header(self, name: str) -> dict[str, tuple[str, list[int], int, int]]:
        """Return the header of a safetensors file: dtype, shape, first and last byte of each tensor, by name.

        Raises:
            UserError: the file is not a safetensors file.
        """
        path = self.path / name
        try:
            with files.open_regular(self._inside(path), _WEIGHTS) as stream:
                return _header(stream)
        except OSError as error:
            raise UserError(f"{path} cannot be read: {error.strerror or error}") from None
        except (ValueError, RecursionError, struct.error) as error:
            raise UserError(f"{path} is not a safetensors file: {_short(error)}") from None

    def tensors(self, name: str, pattern: re.Pattern[str]) -> dict[str, list[float]]:
        """Return the numbers of the tensors whose names match; only these are read.

        Raises:
            UserError: the file is not a safetensors file.
        """
        import numpy as np

        path, numbers = self.path / name, {}
        entries = {key: entry for key, entry in self.header(name).items() if pattern.search(key)}
        with files.open_regular(self._inside(path), _WEIGHTS) as stream:
            for key, (dtype, shape, first, last) in entries.items():
                if last - first > _TENSOR or dtype not in _KINDS:
                    continue
                stream.seek(first)
                kind = np.dtype(_KINDS[dtype])
                data = stream.read(last - first)
                if len(data) != last - first or len(data) != kind.itemsize * math.prod(shape):
                    raise UserError(f"{path}: {key} has another size than its header states")
                numbers[key] = np.frombuffer(data, kind).astype(float).reshape(-1).tolist()
        return numbers

    def pickles(self, *patterns: str) -> str:
        """Return a note on the weight files that are pickles, and so are not opened."""
        files_ = [name for pattern in patterns for name in self.names(pattern)]
        if not files_:
            return f"no {' or '.join(patterns)} is there"
        members = self.members(files_[0])
        content = f"a zip of {len(members)} members, {members[0]} among them" if members else "no zip"
        return f"{', '.join(files_[:3])}: {content}; its pickle is not opened, since that runs code"

    def members(self, name: str) -> list[str]:
        """Return the member names of a ZIP file, such as torch.save writes; [] if it is none.

        Raises:
            UserError: if it cannot be read.
        """
        import zipfile

        path = self.path / name
        try:
            with files.open_regular(self._inside(path), _WEIGHTS) as stream, zipfile.ZipFile(stream) as archive:
                return [entry.filename for entry in archive.infolist()[:_MEMBERS]]
        except (zipfile.BadZipFile, ValueError, EOFError):
            return []
        except (OSError, NotImplementedError) as error:
            raise UserError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from None

    def _text(self, name: str) -> str:
        path = self.path / name
        try:
            return files.read_regular(self._inside(path), _DOCUMENT).decode("utf-8-sig")
        except OSError as error:
            raise UserError(f"{path} cannot be read: {error.strerror or error}") from None
        except UnicodeDecodeError:
            raise UserError(f"{path} is not text in UTF-8") from None

    def _inside(self, path: Path) -> Path:
        """Resolve a path.

        Raises:
            UserError: the target is outside the folder.
        """
        try:
            target = path.resolve()
        except (OSError, RuntimeError) as error:
            raise UserError(f"{path} cannot be read: {error}") from None
        if not any(target.is_relative_to(root) for root in self._roots):
            raise UserError(f"{path} leads out of its folder, to {target}; a checkpoint has to be inside its folder")
        return target

    def _name(self, name: str) -> str:
        return f"{self.label}/{name}" if self.label else name


def _header(stream: IO[bytes]) -> dict[str, tuple[str, list[int], int, int]]:
    (size,) = struct.unpack("<Q", stream.read(8))
    file_size = os.fstat(stream.fileno()).st_size
    header = json_text.parse(stream.read(size)) if 2 <= size <= min(_HEADER, file_size) else None
    if not isinstance(header, dict):
        raise ValueError(f"its header has {size} bytes and is no map")  # noqa: TRY004 - a file, no argument
    return {key: _tensor(key, entry, size, file_size) for key, entry in header.items() if key != "__metadata__"}


def _tensor(key: str, entry: Any, size: int, file_size: int) -> tuple[str, list[int], int, int]:
    shape, offsets = (entry.get(name) if isinstance(entry, dict) else None for name in ("shape", "data_offsets"))
    if not (isinstance(shape, list) and isinstance(offsets, list) and len(offsets) == 2):
        raise ValueError(f"{key} has no shape and offsets")
    if not all(isinstance(one, int) and one >= 0 for one in (*shape, *offsets)) or offsets[1] < offsets[0]:
        raise ValueError(f"{key} has a shape or offsets that are no such numbers")
    if 8 + size + offsets[1] > file_size:
        raise ValueError(f"{key} ends at {8 + size + offsets[1]}, the file at {file_size}")
    return str(entry.get("dtype")), shape, 8 + size + offsets[0], 8 + size + offsets[1]


def _is_sane(number: float) -> bool:
    return -_LARGEST <= number <= _LARGEST


def _flat(value: object, depth: int) -> Iterator[Any]:
    if isinstance(value, list) and depth < 8:
        for entry in value:
            yield from _flat(entry, depth + 1)
    else:
        yield value


def _unquoted(text: str) -> str:
    try:
        return str(json_text.parse(text))
    except ValueError:
        return text[1:-1]


def _short(error: BaseException) -> str:
    return f"{type(error).__name__}: {str(error)[:100]}"
