"""Folders that an adapter's own scripts add to Python's path, read from the scripts; nothing is run.

The reader understands a small part of the shell: assignments, `cd`, defaults such as `${X:-here}`, the usual
expressions for the folder of the script, values of `PYTHONPATH` and arguments of `pip install`. It skips the rest.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

from xpl import _spec as spec

_SERVER = spec.File.SETUP_EVAL_POLICY_SERVER_SH
_SCRIPTS = (spec.File.INSTALL_SH, _SERVER)  # in the order in which they are run
_PATH = "PYTHONPATH"
_MARKS = ("pyproject.toml", "setup.py", "setup.cfg")  # files of an installable folder
_SOURCES = "src"
_LARGEST = 1 << 20

_HERE = re.compile(
    r"""\$\(\s*cd\s+(?:--\s+)?"?\$\(\s*dirname\s+[^()]*\)(?P<below>[^"()]*)"?\s*&&\s*pwd(?:\s+-P)?\s*\)"""
)
_THERE = re.compile(r"""\$\(\s*cd\s+(?:--\s+)?"?(?P<folder>[^"()]+?)"?\s*&&\s*pwd(?:\s+-P)?\s*\)""")
_FOLDER = re.compile(r"""\$\(\s*dirname\s+(?:--\s+)?"?(?P<path>[^"()]+?)"?\s*\)""")
_BASENAME = re.compile(r"""\$\(\s*basename\s+(?:--\s+)?"?(?P<path>[^"()]+?)"?\s*\)""")
_VARIABLE = re.compile(r"\$\{(?P<name>\w+)(?::?-(?P<default>[^{}]*))?\}|\$(?P<plain>[A-Za-z_]\w*|\d)")
_ASSIGNED = re.compile(
    r"^\s*(?:export\s+|local\s+|readonly\s+|declare\s+(?:-\w+\s+)*)?(?P<name>[A-Za-z_]\w*)=(?P<value>.*)$"
)
_IN_PATH = re.compile(rf"""(?<![\w$]){_PATH}=(?P<value>"[^"]*"|'[^']*'|\S+)""")
_PARTS = re.compile(rf"""(?<![\w$]){_PATH}_\w+\+?=\((?P<values>[^)]*)\)""")
_CHANGED = re.compile(r"""^\s*(?:cd|pushd)\s+(?P<folder>"[^"]+"|'[^']+'|[^\s;&|]+)""")
_INSTALLS = re.compile(r"\bpip3?\s+install\b(?P<words>.*)|\bsetup\.py\s+(?:develop|install)\b")
_OVERRIDES = re.compile(r"--overrides\b|\b\w*(?:OVERRIDES|overrides)\w*\+?=\(")
_PAIR = re.compile(r"""(?<![\w$"'{])(?P<name>[A-Za-z_]\w*)=(?P<value>"[^"]*"|'[^']*'|[^\s)"']*)""")
_SUBSTITUTED = re.compile(r"\$\([^()]*\)|\$\{[^{}]*\}")
_SETS_UP = re.compile(r"\b(?:uv|poetry)\s+(?:sync|install)\b")


def python_path(policy_dir: Path) -> list[Path]:
    """Return the folders of an adapter that its scripts add to Python's path, in the order of the path.

    Only existing folders inside the adapter's folder are returned.
    """
    home = policy_dir.resolve()
    installed: list[Path] = []
    ahead: list[Path] = []
    for name in _SCRIPTS:
        for folder, is_installed in _ScriptReader(home, name).folders():
            places = installed if is_installed else ahead
            if folder not in places and home in (folder, *folder.parents) and folder.is_dir():
                places.append(folder)
    return ahead + [folder for folder in installed if folder not in ahead]


def settings(policy_dir: Path, arguments: Sequence[str]) -> dict[str, str]:
    """Return the keys of deploy.yml that the server's start script overrides, as far as they can be read.

    Args:
        policy_dir: folder of the adapter.
        arguments: arguments of the script, in order.

    Returns:
        values as text, by key; without empty values and those that only a running shell can compute.
    """
    return _ScriptReader(policy_dir.resolve(), _SERVER, arguments).settings()


class _ScriptReader:
    """Reads one script from its first to its last line, as if the shell ran every line."""

    def __init__(self, home: Path, name: str, arguments: Sequence[str] = ()) -> None:
        self._home = home
        self._folder = home
        self._values = {"PWD": str(home), "0": str(home / name), "BASH_SOURCE": str(home / name)}
        self._values.update((str(place), word) for place, word in enumerate(arguments, 1))
        try:
            path = home / name
            is_small = path.stat().st_size <= _LARGEST
            self._lines = (
                path.read_text(encoding="utf-8", errors="replace").replace("\\\n", " ").splitlines() if is_small else []
            )
        except OSError:
            self._lines = []

    def folders(self) -> Iterator[tuple[Path, bool]]:
        """Yield each folder, and whether the script installs the folder's packages."""
        for line in self._lines:
            if not line.lstrip().startswith("#"):
                yield from self._on_path(line)
                self._remember(line)
                yield from self._set_up(line)

    def settings(self) -> dict[str, str]:
        """Return the keys of deploy.yml that are overridden, with their values."""
        overrides: dict[str, str] = {}
        is_within = False
        for line in self._lines:
            if line.lstrip().startswith("#"):
                continue
            begins = _OVERRIDES.search(line)
            if begins is not None or is_within:
                for pair in _PAIR.finditer(line if begins is None else line[begins.end() :]):
                    value = self._expanded(_bare(pair["value"]))
                    if value.strip("'") and "$" not in value and "`" not in value:
                        overrides.setdefault(pair["name"], value)
                is_within = ")" not in _SUBSTITUTED.sub("", line) if begins is None or "(" in begins[0] else False
            else:
                self._remember(line)
        return overrides

    def _on_path(self, line: str) -> Iterator[tuple[Path, bool]]:
        for found in _IN_PATH.finditer(line):
            for part in self._expanded(_bare(found["value"])).split(":"):
                yield from self._path_entry(part)
        for found in _PARTS.finditer(line):
            for part in _words(self._expanded(found["values"])):
                yield from self._path_entry(part)

    def _remember(self, line: str) -> None:
        """Remember the assignment of a line and its change of folder."""
        assigned = _ASSIGNED.match(line)
        if assigned is not None and assigned["name"] != _PATH:
            value = self._expanded(_bare(assigned["value"]))
            if (value and "$" not in value) or not self._values.get(assigned["name"]):
                self._values[assigned["name"]] = value  # of several branches the last one, usually the default
        changed = _CHANGED.match(line)
        if changed is not None:
            self._enter(self._expanded(_bare(changed["folder"])))

    def _set_up(self, line: str) -> Iterator[tuple[Path, bool]]:
        installs = _INSTALLS.search(line)
        if installs is not None:
            for word in _words(self._expanded(installs["words"] or ".")):
                yield from self._installed(word)
        elif _SETS_UP.search(line):
            yield from self._installed(".")

    def _path_entry(self, part: str) -> Iterator[tuple[Path, bool]]:
        if part.strip() and "$" not in part:
            yield self._placed(part.strip()), False

    def _installed(self, word: str) -> Iterator[tuple[Path, bool]]:
        """Yield the folder that contains the packages of an installed folder."""
        folder = self._placed(word.partition("[")[0])
        if "$" in word or not any((folder / mark).is_file() for mark in _MARKS):
            return
        sources = folder / _SOURCES
        yield (sources if sources.is_dir() and not (sources / spec.File.INIT_PY).is_file() else folder), True

    def _enter(self, folder: str) -> None:
        there = self._placed(folder)
        if "$" not in folder and there.is_dir():
            self._folder = there

    def _placed(self, text: str) -> Path:
        return Path((self._folder / text).as_posix()).resolve()

    def _expanded(self, text: str) -> str:
        """Return a text with its known expressions expanded; the others keep their `$`."""
        text = _HERE.sub(lambda found: str(self._placed(str(self._home) + found["below"])), text)
        for _ in range(4):  # values that hold values
            before = text
            text = _VARIABLE.sub(self._value, text)
            text = _THERE.sub(lambda found: str(self._placed(found["folder"])), text)
            text = _FOLDER.sub(lambda found: str(Path(found["path"]).parent), text)
            text = _BASENAME.sub(lambda found: Path(found["path"]).name, text)
            if text == before:
                break
        return text

    def _value(self, match: re.Match[str]) -> str:
        name = match["name"] or match["plain"]
        if name in self._values:
            return self._values[name]
        if name == _PATH:
            return ""
        return match[0] if match["default"] is None else match["default"]


def _bare(text: str) -> str:
    """Return a word without the quotes around it, and without a comment behind it."""
    text = text.strip()
    if text[:1] in ('"', "'"):
        end = text.find(text[0], 1)
        nested = text.rfind(text[0])
        return text[1 : nested if "$(" in text else end] if end > 0 else text[1:]
    return re.split(r"\s+(?:#|&&|\|\||;)", text, maxsplit=1)[0]


def _words(text: str) -> list[str]:
    try:
        return shlex.split(text, comments=True)
    except ValueError:
        return text.split()
