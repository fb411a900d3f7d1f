"""Files of vendored trees: not the adapter's code, but published with it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.rules.model import NotRun

if TYPE_CHECKING:
    from xpl_cli.audit.static.source import Source

_SUFFIXES: Final = (".cfg", ".py", ".sh", ".toml", ".yaml", ".yml")
_MOST_FILES: Final = 4000
_LARGEST: Final = 256 * 1024
"""Bytes; larger files are generated, or data."""
_DATA: Final = frozenset(("checkpoints", "data", "datasets", "node_modules", "outputs", "results", "wandb"))
"""Folders directly in the adapter's folder with outputs and data instead of code."""


def texts(source: Source) -> Iterator[tuple[str, str]]:
    """Yield the text files in subfolders that are not part of the boundary, by name; links are not followed."""
    own_files = set(source.files)
    for name in _names(source):
        if name not in own_files:
            with suppress(NotRun):
                yield name, source.text(name)


def _names(source: Source) -> tuple[str, ...]:
    """Return the names of those files, sorted, up to a limit."""
    if texts not in source.views:
        paths: list[str] = []
        for folder, inner, files in os.walk(source.path):
            relative = os.path.relpath(folder, source.path).replace(os.sep, "/")
            is_top = relative == "."
            inner[:] = sorted(
                name for name in inner if not name.startswith((".", "__")) and not (is_top and name in _DATA)
            )
            for name in sorted(files) if not is_top else ():
                whole = os.path.join(folder, name)  # noqa: PTH118 - a Path for each of thousands of files takes longer
                with suppress(OSError):
                    if name.endswith(_SUFFIXES) and not os.path.islink(whole) and os.path.getsize(whole) <= _LARGEST:  # noqa: PTH114, PTH202
                        paths.append(f"{relative}/{name}")
            if len(paths) > _MOST_FILES:
                break
        source.views[texts] = tuple(paths[:_MOST_FILES])
    names: tuple[str, ...] = source.views[texts]
    return names
