"""Reads a folder that somebody else's training wrote: bounded, inside the folder, and without running anything in it.

No pickle is opened: of a `.pth` or `.ckpt` that is a zip only the members' names are listed. Every problem is one
`UserError` that names file and place.
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
"""Bytes of a JSON or YAML document; statistics of hundreds of data sets have ten million."""
_HEADER: Final = 64 << 20
"""Bytes of the header of a safetensors file."""
_WEIGHTS: Final = 1 << 42
_TENSOR: Final = 1 << 20
"""Bytes of one tensor that is read: statistics are vectors."""
_MEMBERS: Final = 20_000
_LISTED: Final = 40
_ENTRIES: Final = 20_000
"""Entries of a folder that are looked through."""
_MOST_NUMBERS: Final = 10_000
_LARGEST: Final = 1e15
"""No count, size or statistic of a checkpoint is larger."""
_KINDS: Final = {"F64": "<f8", "F32": "<f4", "F16": "<f2", "I64": "<i8", "I32": "<i4", "U8": "u1", "BOOL": "?"}
_TOKEN: Final = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\]:,]')
_WORDS: Final = {dict: "a map", list: "a list", str: "a text", int: "a whole number", float: "a number", bool: "a flag"}

Value = TypeVar("Value")
_MISSING: Final = object()


class Document:
    """One JSON or YAML document, whose values are asked for by path and type.

    Args:
        file: its name as evidence gives it.
        value: what it holds.
        text: its text, where lines can be told.
        path: where it is, for errors.
    """

    def __init__(self, file: str, value: object, text: str = "", path: Path | None = None) -> None:
        self.file = file
        self.value = value
        self._text = text
        self._path = path or Path(file)

    def get(self, kind: type[Value], *path: str | int, default: Any = _MISSING) -> Value:
        """Return the value at a path.

        Args:
            kind: what it has to be; an int is a float too.
            path: keys and positions.
            default: what comes back if it is not there, or null; an error by default.

        Raises:
            UserError: if it is missing, or something else.
        """
        found = self.at(*path)
        if found is None and default is not _MISSING:
            return default  # type: ignore[no-any-return]
        is_number = isinstance(found, (int, float)) and not isinstance(found, bool)
        fits = isinstance(found, kind) and (kind is bool or not isinstance(found, bool))
        if kind is dict and fits and len(found) > _MOST_NUMBERS:
            raise UserError(f"{self.place()}: expected {_MOST_NUMBERS} entries at most at {'/'.join(map(str, path))}")
        if kind in {int, float} and is_number:
            fits = (fits or kind is float) and _is_sane(found)
            found = float(found) if fits and kind is float else found
        if not fits:
            came = "nothing" if found is None else f"{str(found)[:60]!r}"
            place = "/".join(map(str, path)) or "the document"
            raise UserError(f"{self.place(*path)}: expected {_WORDS[kind]} at {place}, got {came}")
        return found  # type: ignore[no-any-return]

    def at(self, *path: str | int) -> Any:
        """Return the value at a path, whatever it is; None where there is none."""
        value = self.value
        for word in path:
            if isinstance(value, Mapping) and word in value:
                value = value[word]
            elif isinstance(value, Sequence) and isinstance(word, int) and not isinstance(value, str):
                value = value[word] if -len(value) <= word < len(value) else None
            else:
                return None
        return value

    def numbers(self, *path: str | int) -> list[float] | None:
        """Return a list of finite numbers, nested lists flattened; None where there is nothing.

        Raises:
            UserError: if it holds something else, or very many.
        """
        found = self.at(*path)
        if found is None:
            return None
        flat = list(_flat(found, 0))
        if len(flat) > _MOST_NUMBERS or not all(
            isinstance(one, (int, float)) and not isinstance(one, bool) and _is_sane(one) for one in flat
        ):
            raise UserError(f"{self.place(*path)}: expected a list of finite numbers at {'/'.join(map(str, path))}")
        return [float(one) for one in flat]

    def texts(self, *path: str | int) -> list[str] | None:
        """Return a list of texts; None where there is something else."""
        found = self.at(*path)
        fits = (
            isinstance(found, list) and 0 < len(found) <= _MOST_NUMBERS and all(isinstance(one, str) for one in found)
        )
        return found if fits else None

    def chosen(self, names: Iterable[object], wanted: str | None) -> str:
        """Return which of several entries of statistics counts: the one that the user named, or the only one.

        Args:
            names: of the entries.
            wanted: what the user named; None where nothing was.

        Raises:
            UserError: there is none of that name, or nobody says which of several; it lists them.
        """
        known = [str(name) for name in names]
        if wanted in known:
            return wanted
        if len(known) == 1 and wanted is None:
            return known[0]
        asked = f"--statistics {wanted}: " if wanted else "statistics of several data sets or robots: "
        listed = ", ".join(known[:_LISTED]) or "none"
        hint = f"--statistics NAME says which counts, such as {known[0]}" if known else None
        raise UserError(f"{self.place()}: {asked}there are {listed}", hint=hint)

    def seen(self, *path: str | int, what: str | None = None) -> Evidence:
        """Return the place of a value as evidence, with the value itself."""
        shown = what
        if shown is None:
            value = self.at(*path)
            name = "/".join(map(str, path))
            shown = f"{name}: {json.dumps(value, default=str)[:60]}" if not isinstance(value, Mapping) else name
        return Evidence(self.file, self.line(*path), shown)

    def place(self, *path: str | int) -> str:
        """Return path and line of a value, for an error."""
        line = self.line(*path)
        return str(self._path) if line is None else f"{self._path}:{line}"

    def line(self, *path: str | int) -> int | None:
        """Return the line of the key that a path ends with, from 1; None where it cannot be told."""
        return self._lines.get(tuple(word for word in path if isinstance(word, str)))

    @cached_property
    def _lines(self) -> dict[tuple[str, ...], int]:
        """The line of each key, by the keys that lead to it; of equal ones in a list the first."""
        found: dict[tuple[str, ...], int] = {}
        above: list[str | None] = []
        key: str | None = None
        line, place = 1, 0
        for token in _TOKEN.finditer(self._text):
            line += self._text.count("\n", place, token.start())
            place = token.start()
            text = token[0]
            if text in "{[":
                above.append(key)
                key = None
            elif text in "}]":
                key = above.pop() if above else None
            elif text[0] == '"' and self._text[token.end() : token.end() + 40].lstrip().startswith(":"):
                key = _unquoted(text)
                found.setdefault((*(word for word in above if word is not None), key), line)
        return found


class Folder:
    """A folder, read with care. Links may lead inside it, or into the blobs of the hub's cache that it lies in.

    Args:
        path: the folder.
        told: how evidence calls it, "" for file names alone.
    """

    def __init__(self, path: Path, told: str = "") -> None:
        self.path = path
        self.told = told
        self._root = path.resolve()
        # A snapshot in the hub's cache is links to the blobs two folders above.
        self._roots = (self._root, self._root.parents[1]) if self._root.parent.name == "snapshots" else (self._root,)

    def below(self, name: str) -> Folder:
        """Return a folder in this one."""
        self._inside(self.path / name)
        return Folder(self.path / name, self._name(name))

    def has(self, name: str) -> bool:
        """Tell whether there is a file or folder of this name."""
        try:
            return (self.path / name).exists()
        except OSError:
            return False

    def names(self, pattern: str) -> list[str]:
        """Return the names that match a pattern, relative to the folder, sorted.

        Raises:
            UserError: if the folder holds far more than any checkpoint does.
        """
        found: list[str] = []
        try:
            for count, entry in enumerate(self.path.glob(pattern)):
                if count >= _ENTRIES:
                    raise UserError(f"{self.path} holds more than {_ENTRIES} entries: expected one checkpoint")
                found.append(entry.relative_to(self.path).as_posix())
        except OSError as error:
            raise UserError(f"{self.path} cannot be read: {error.strerror or error}") from None
        return sorted(found)

    def json(self, name: str) -> Document:
        """Return a JSON document.

        Raises:
            UserError: if it cannot be read, is too large, or is no JSON.
        """
        text = self._text(name)
        try:
            return Document(self._name(name), json_text.parse(text), text, self.path / name)
        except json_text.JsonError as error:
            raise UserError(f"{self.path / name}: {error}") from None

    def yaml(self, name: str) -> Document:
        """Return a YAML document of plain values; tags that name classes are refused.

        Raises:
            UserError: if it cannot be read, is too large, or is no YAML.
        """
        import yaml

        from xpl_cli.basics.yaml.text import parse

        text = self._text(name)
        try:
            return Document(self._name(name), parse(text), "", self.path / name)
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
        """Return what a safetensors file says it holds: name to dtype, shape, first and last byte of its numbers.

        Raises:
            UserError: if it is no such file.
        """
        path = self.path / name
        try:
            with files.opened(self._inside(path), _WEIGHTS) as stream:
                return _header(stream)
        except OSError as error:
            raise UserError(f"{path} cannot be read: {error.strerror or error}") from None
        except (ValueError, RecursionError, struct.error) as error:
            raise UserError(f"{path} is not a safetensors file: {_short(error)}") from None

    def tensors(self, name: str, wanted: re.Pattern[str]) -> dict[str, list[float]]:
        """Return the numbers of the tensors of a safetensors file whose names match; only these are read.

        Raises:
            UserError: if it is no such file.
        """
        import numpy as np

        path, found = self.path / name, {}
        entries = {key: entry for key, entry in self.header(name).items() if wanted.search(key)}
        with files.opened(self._inside(path), _WEIGHTS) as stream:
            for key, (dtype, shape, first, last) in entries.items():
                if last - first > _TENSOR or dtype not in _KINDS:
                    continue
                stream.seek(first)
                kind = np.dtype(_KINDS[dtype])
                data = stream.read(last - first)
                if len(data) != last - first or len(data) != kind.itemsize * math.prod(shape):
                    raise UserError(f"{path}: {key} has not the numbers that its header tells")
                found[key] = np.frombuffer(data, kind).astype(float).reshape(-1).tolist()
        return found

    def pickles(self, *patterns: str) -> str:
        """Return, for a note, which files of weights there are that are pickles, and so are not opened."""
        found = [name for pattern in patterns for name in self.names(pattern)]
        if not found:
            return f"no {' or '.join(patterns)} is there"
        members = self.members(found[0])
        held = f"a zip of {len(members)} members, {members[0]} among them" if members else "no zip"
        return f"{', '.join(found[:3])}: {held}; its pickle is not opened, since that runs code"

    def members(self, name: str) -> list[str]:
        """Return the names in a zip file, such as torch.save writes; nothing in it is opened. [] if it is no zip.

        Raises:
            UserError: if it cannot be read.
        """
        import zipfile

        path = self.path / name
        try:
            with files.opened(self._inside(path), _WEIGHTS) as stream, zipfile.ZipFile(stream) as archive:
                return [entry.filename for entry in archive.infolist()[:_MEMBERS]]
        except (zipfile.BadZipFile, ValueError, EOFError):
            return []
        except (OSError, NotImplementedError) as error:
            raise UserError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from None

    def _text(self, name: str) -> str:
        path = self.path / name
        try:
            return files.content(self._inside(path), _DOCUMENT).decode("utf-8-sig")
        except OSError as error:
            raise UserError(f"{path} cannot be read: {error.strerror or error}") from None
        except UnicodeDecodeError:
            raise UserError(f"{path} is not text in UTF-8") from None

    def _inside(self, path: Path) -> Path:
        """Return where a path leads.

        Raises:
            UserError: if that is outside.
        """
        try:
            target = path.resolve()
        except (OSError, RuntimeError) as error:
            raise UserError(f"{path} cannot be read: {error}") from None
        if not any(target.is_relative_to(root) for root in self._roots):
            raise UserError(f"{path} leads out of its folder, to {target}; a checkpoint is read where it lies")
        return target

    def _name(self, name: str) -> str:
        return f"{self.told}/{name}" if self.told else name


def _header(stream: IO[bytes]) -> dict[str, tuple[str, list[int], int, int]]:
    (size,) = struct.unpack("<Q", stream.read(8))
    whole = os.fstat(stream.fileno()).st_size
    header = json_text.parse(stream.read(size)) if 2 <= size <= min(_HEADER, whole) else None
    if not isinstance(header, dict):
        raise ValueError(f"its header has {size} bytes and is no map")  # noqa: TRY004 - a file, no argument
    return {key: _tensor(key, entry, size, whole) for key, entry in header.items() if key != "__metadata__"}


def _tensor(key: str, entry: Any, size: int, whole: int) -> tuple[str, list[int], int, int]:
    shape, offsets = (entry.get(name) if isinstance(entry, dict) else None for name in ("shape", "data_offsets"))
    if not (isinstance(shape, list) and isinstance(offsets, list) and len(offsets) == 2):
        raise ValueError(f"{key} has no shape and offsets")
    if not all(isinstance(one, int) and one >= 0 for one in (*shape, *offsets)) or offsets[1] < offsets[0]:
        raise ValueError(f"{key} has a shape or offsets that are no such numbers")
    if 8 + size + offsets[1] > whole:
        raise ValueError(f"{key} ends at {8 + size + offsets[1]}, the file at {whole}")
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
