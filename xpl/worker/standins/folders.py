"""Checkpoints that are not here: files and folders that are there as soon as an adapter looks for them.

Below the places where weights belong, what does not exist is taken to exist: with a suffix as a file, without one as a
folder. What is read from such a file is a thing; what is written is gone when it is closed. Nothing outside of these
places changes, and nothing that exists is hidden.
"""

from __future__ import annotations

import builtins
import fnmatch
import functools
import glob
import io
import json
import os
import pathlib
import pickle
import re
import tempfile
from pathlib import Path
from typing import Any, Callable

import numpy as np

from xpl.worker.standins.given import Memory
from xpl.worker.standins.origins import Origin
from xpl.worker.standins.things import Thing

ROOT = "xpl-stand-in"
"""Name of the folder that paths of a configuration point to where it says nothing."""
_PLACE = re.compile(
    r"checkpoints?|ckpts?|weights?|pretrained.*|.*models?|norm_?stats.*|stats?|assets|embeddings?|xpl-stand-in|.*_(ckpt|weights)"
)
_LISTED = (
    "checkpoint-1000", "1000", "step_1000", "model.safetensors", "model.pt", "1000.ckpt", "pretrained_model",
    "config.json",
)  # fmt: skip
_SUFFIX = re.compile(r".*\.(pt|pth|ckpt|bin|safetensors|json|ya?ml|pkl|npz?|txt|toml|model|msgpack|h5|hdf5|parquet)")


class Text(str):
    """The text of a file that is not here."""

    __slots__ = ("name",)
    name: str

    def __new__(cls, name: str) -> Text:
        made = super().__new__(cls, "")
        made.name = name
        return made

    def strip(self, *_: Any) -> Any:
        return self


class _File(io.StringIO):
    def __init__(self, path: str, *, binary: bool) -> None:
        super().__init__()
        self.name, self._binary = path, binary

    def read(self, *_: Any) -> Any:
        return b"" if self._binary else Text(self.name)


class Folders:
    """The places of weights of an adapter.

    Args:
        roots: folders below which they lie.
    """

    def __init__(self, roots: list[Path]) -> None:
        self._roots = [os.path.realpath(root) for root in roots]
        self.files: set[str] = set()
        self._added: set[str] = set()
        self._stat = os.stat
        self._exists = os.path.lexists
        self.root = os.path.join(self._roots[0], ROOT)

    def is_ours(self, path: Any) -> bool:
        """Tell whether a path is one of those that are taken to exist."""
        if isinstance(path, (int, bytes)):
            return False
        text = os.path.abspath(os.fspath(path))
        if text.endswith(".latest") or self._exists(text):
            return False
        if any(text == path or text.startswith(path + os.sep) for path in self._added):
            return True
        for root in self._roots:
            if text.startswith(root + os.sep):
                below = text[len(root) + 1 :].split(os.sep)
                return any(_PLACE.fullmatch(part.lower()) for part in below) or any(
                    _PLACE.fullmatch(part.partition(".")[0].lower()) and _SUFFIX.fullmatch(part) for part in below[-1:]
                )
        return False

    def add(self, path: str) -> bool:
        """Take a path to exist that an adapter asked for; tell whether that is news."""
        text = os.path.abspath(path).rstrip("/.,")
        inside = any(text.startswith(root + os.sep) for root in self._roots)
        if not inside or self._exists(text) or self.is_ours(text):
            return False
        self._added.add(text)
        return True

    def is_file(self, path: Any) -> bool:
        """Tell whether such a path is a file."""
        if isinstance(path, Thing):
            return False
        return bool(_SUFFIX.fullmatch(os.fspath(path))) or os.path.basename(os.fspath(path)).endswith("_file")

    def listing(self, path: Any) -> list[str]:
        """Return what lies in such a folder: each form in which steps are written; only files below a step."""
        inner = os.path.basename(os.fspath(path)) in _LISTED
        return [name for name in _LISTED if not inner or _SUFFIX.fullmatch(name) or name == "pretrained_model"]

    def install(self) -> None:
        """Let the paths exist from now on."""
        ours = self.is_ours

        def stat(path: Any, *arguments: Any, **named: Any) -> Any:
            try:
                return self._stat(path, *arguments, **named)
            except (FileNotFoundError, NotADirectoryError):
                if named.get("dir_fd") is None and ours(path):
                    return self._stat(__file__ if self.is_file(path) else os.path.dirname(__file__))
                raise

        os.stat = stat
        self._patch(os.path, "exists", lambda real, path: _safely(ours, path) or real(path))
        self._patch(
            os.path, "isfile", lambda real, path: (_safely(ours, path) and self._may_be_file(path)) or real(path)
        )
        self._patch(os.path, "isdir", lambda real, path: (_safely(ours, path) and not self.is_file(path)) or real(path))
        self._patch(os.path, "getmtime", lambda real, path: 0.0 if ours(path) else real(path))
        self._patch(os.path, "getsize", lambda real, path: 0 if ours(path) else real(path))
        self._patch(os, "listdir", lambda real, path=".": self.listing(path) if ours(path) else real(path))
        self._patch(os, "makedirs", lambda real, path, *a, **k: None if ours(path) else real(path, *a, **k))
        self._patch(pathlib.Path, "exists", lambda real, path, **k: real(path, **k) or ours(path))
        self._patch(
            pathlib.Path, "is_file", lambda real, path, **k: real(path, **k) or (ours(path) and self._may_be_file(path))
        )
        self._patch(
            pathlib.Path, "is_dir", lambda real, path, **k: real(path, **k) or (ours(path) and not self.is_file(path))
        )
        self._patch(pathlib.Path, "mkdir", lambda real, path, *a, **k: None if ours(path) else real(path, *a, **k))
        self._patch(
            pathlib.Path,
            "iterdir",
            lambda real, path: iter([path / n for n in self.listing(path)]) if ours(path) else real(path),
        )
        for name in ("glob", "rglob"):
            self._patch(
                pathlib.Path,
                name,
                lambda real, path, pattern, **k: self._glob(path, pattern) if ours(path) else real(path, pattern, **k),
            )
        self._patch(glob, "glob", lambda real, pattern, **k: real(pattern, **k) or self._glob_text(pattern))
        self._patch(
            pathlib.Path,
            "open",
            lambda real, path, mode="r", *a, **k: self._open(path, mode) if ours(path) else real(path, mode, *a, **k),
        )
        for name in ("read_text", "read_bytes"):
            self._patch(
                pathlib.Path, name, lambda real, path, *a, **k: Text(str(path)) if ours(path) else real(path, *a, **k)
            )
        self._patch(
            builtins,
            "open",
            lambda real, path, mode="r", *a, **k: (
                self._open(path, mode)
                if not isinstance(path, int) and _safely(ours, path)
                else real(path, mode, *a, **k)
            ),
        )
        self._patch(json, "load", lambda real, file, **k: _document(file) or real(file, **k))
        self._patch(json, "loads", lambda real, text, **k: _document(text) or real(text, **k))
        self._patch(
            json,
            "dump",
            lambda real, item, file, **k: file.write("{}") if isinstance(item, Thing) else real(item, file, **k),
        )
        self._patch(json, "dumps", lambda real, item, **k: "{}" if isinstance(item, Thing) else real(item, **k))
        self._patch(pickle, "load", lambda real, file, **k: _document(file) or real(file, **k))
        self._patch(
            np,
            "load",
            lambda real, file, *a, **k: (
                _document(file)
                or (
                    Thing(Origin(_stem(file), Memory()))
                    if isinstance(file, (str, os.PathLike)) and ours(file)
                    else real(file, *a, **k)
                )
            ),
        )
        try:
            import yaml
        except ImportError:
            return
        for name in ("safe_load", "load", "full_load"):
            self._patch(yaml, name, lambda real, file, *a, **k: _document(file) or real(file, *a, **k))

    def _may_be_file(self, path: Any) -> bool:
        if isinstance(path, Thing):
            return True
        return self.is_file(path) or os.path.basename(os.fspath(path)) in self.files

    def _open(self, path: Any, mode: str) -> Any:
        if "r" in mode and "+" not in mode:
            return _File(os.fspath(path), binary="b" in mode)
        return tempfile.TemporaryFile(mode)  # gone when it is closed

    def _glob(self, path: Any, pattern: str) -> list[Path]:
        last = pattern.rpartition("/")[2]
        names = [name for name in self.listing(path) if fnmatch.fnmatch(name, last)]
        return [Path(path) / name for name in names or [last.replace("*", "1000")]]

    def _glob_text(self, pattern: str) -> list[str]:
        folder, _, _ = pattern.partition("*")
        folder = folder.rpartition("/")[0]
        return [str(found) for found in self._glob(folder, pattern)] if folder and self.is_ours(folder) else []

    def _patch(self, owner: Any, name: str, new: Callable[..., Any]) -> None:
        real = getattr(owner, name)

        @functools.wraps(real)
        def patched(*arguments: Any, **named: Any) -> Any:
            return new(real, *arguments, **named)

        setattr(owner, name, patched)


def _safely(ours: Callable[[Any], bool], path: Any) -> bool:
    if isinstance(path, Thing):
        return True
    try:
        return ours(path)
    except (TypeError, ValueError):
        return False


def _stem(file: Any) -> str:
    return Path(os.fspath(file)).stem.replace(".", "_") or "file"


def _document(source: Any) -> Any:
    """Return what a file that is not here says: a thing; None for any other source."""
    if isinstance(source, Text):
        return _Document(Origin(_stem(source.name), Memory(), is_text=True))
    return _Document(Origin(_stem(source.name), Memory(), is_text=True)) if isinstance(source, _File) else None


class _Document(Thing):
    """What a file says; true, so that it is taken for a map with something in it."""

    def __bool__(self) -> bool:
        return True
