"""Cache of passes of the static gate, by content: an adapter that has not changed is not read again.

A rule that does not apply (`not_applicable`) counts as a pass here: that follows from the same files.

A record belongs to one state of one package: all names in its folder and the content of the files directly in it. It
holds the content of the deeper files that were read, and the rules that passed, each with a digest of the rule's folder
and of everything that rules depend on (engine, SDK, standard). Findings and rules that could not run are never
cached. Only rules that need nothing but the files take part; the gates that serve an adapter depend on far more.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import yaml

from xpl import json_text
from xpl.robots import HANDED_ON
from xpl_cli import __version__
from xpl_cli.audit.rules.model import NotRun, Outcome, RuleResult
from xpl_cli.audit.rules.registry import lookup
from xpl_cli.audit.static.file_reading import SIZE_LIMIT
from xpl_cli.basics import content, files, user_cache
from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from xpl_cli.audit.rules.registry import RuleEntry
    from xpl_cli.audit.static.source import Source

LIMIT: Final = 1024
"""Most records in the cache; beyond it the least recently used ones are deleted."""

_FORMAT: Final = 2
_MOST_NAMES: Final = 50_000
"""A folder with more names than this is not scanned: nothing is cached for it."""
_PARTS: Final = 4
"""Length of a rule's entry: its version, requirement, severity, and why it does not apply (empty for a pass)."""
_UNREAD: Final = frozenset((".git", "__pycache__"))
_FACTS: Final = frozenset(("source",))
"""Facts that follow from the files of the package."""


_PACKAGES: Final = ("audit", "basics", "packages", "scaffold", "standard")
"""Packages of the engine on which rules of the static gate depend."""


def default_folder() -> Path | None:
    """Return the cache folder of the user, or None."""
    with suppress(UserError):
        return user_cache.folder() / "audit"
    return None


@dataclass
class PassCache:
    """The cached passes for one state of one package.

    Attributes:
        record: hash of the boundary, as `Source.whole` returns it; empty if unknown.
    """

    package: Path
    file: Path
    record: str = ""
    _files: dict[str, str] = field(default_factory=dict)
    _passes: dict[str, list[str]] = field(default_factory=dict)
    _is_dirty: bool = False

    @classmethod
    def of(cls, folder: Path, package: Path) -> PassCache | None:
        """Return the passes for a package in its present state, None if its folder cannot be scanned.

        Args:
            folder: the cache folder.
            package: the package.
        """
        try:
            passes = cls(package, folder / f"{_state(package)}.json")
        except (OSError, ValueError):
            return None
        passes._load()
        return passes

    def get(self, entry: RuleEntry) -> RuleResult | None:
        """Return the pass of a rule, None if the rule has to run."""
        cached = self._passes.get(entry.code)
        if cached is None or cached[0] != _version(entry):
            return None
        _, requirement, severity, reason = cached
        outcome = Outcome.NOT_APPLICABLE if reason else Outcome.PASS
        return RuleResult(entry.code, entry.slug, requirement, severity, outcome, reason=reason or None)

    def put(self, entry: RuleEntry, result: RuleResult, facts: tuple[str, ...]) -> None:
        """Add the result of a rule, if it is a pass that follows from the files alone."""
        reason = result.reason or ""
        is_sound = result.outcome is Outcome.PASS or (result.outcome is Outcome.NOT_APPLICABLE and reason)
        if is_sound and result.proof is None and _FACTS.issuperset(facts):
            self._passes[entry.code] = [_version(entry), result.requirement, result.severity, reason]
            self._is_dirty = True

    def save(self, source: Source) -> None:
        """Write the record. Nothing is written if that fails, or if the package changed meanwhile."""
        if not self._is_dirty:
            return
        from xpl_cli.basics.atomic import write_file

        with suppress(OSError, ValueError, NotRun):
            names = {name for name in (*source.files, *source.files_read) if "/" in name}
            self._files = {name: _digest(self.package / name) for name in sorted(names)}
            self.record = source.boundary_hash()
            if self.file.name != f"{_state(self.package)}.json":
                return
            others = PassCache(self.package, self.file)
            others._load()
            passes = {**others._passes, **self._passes} if others._files == self._files else self._passes
            passes = {code: kept for code, kept in passes.items() if lookup(code) is not None}  # rules may be retired
            document = {"format": _FORMAT, "files": self._files, "record": self.record, "passes": passes}
            self.file.parent.mkdir(parents=True, exist_ok=True)
            write_file(self.file, json.dumps(document).encode(), mode=0o600)
            _prune(self.file.parent)

    def _load(self) -> None:
        """Read the record; one that is invalid, or of other deeper files, is ignored."""
        with suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
            document: dict[str, Any] = json_text.parse(files.read_regular(self.file))
            deeper = {str(name): str(digest) for name, digest in document["files"].items()}
            passes = {str(code): [str(part) for part in kept] for code, kept in document["passes"].items()}
            if document["format"] != _FORMAT or any(len(kept) != _PARTS for kept in passes.values()):
                return
            if any(_digest(self.package / name) != digest for name, digest in deeper.items()):
                return
            self._files, self._passes, self.record = deeper, passes, str(document["record"])
            os.utime(self.file)


def _state(package: Path) -> str:
    """Return a hash of a package's name, of all names in its folder, of the files directly in it, and of open robots.

    Raises:
        OSError: if it cannot be scanned.
        ValueError: if it holds too many names.
    """
    state = hashlib.sha256(os.fsencode(package.name))
    state.update(os.environ.get(HANDED_ON, "").encode())  # rules compare manifests with the robots of the project
    waiting, names = [package], 0
    while waiting:
        folder = waiting.pop()
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
        names += len(entries)
        if names > _MOST_NAMES:
            raise ValueError(f"{package} holds more than {_MOST_NAMES} names")
        state.update(b"\0\0" + os.fsencode(os.path.relpath(folder, package)))
        for entry in entries:
            if entry.name not in _UNREAD:
                entry_state = _entry_state(entry, direct=folder is package)
                state.update(b"\0" + os.fsencode(entry.name) + b"\0" + entry_state)
                if entry_state == b"folder":
                    waiting.append(Path(entry.path))
    return state.hexdigest()


def _entry_state(entry: os.DirEntry[str], *, direct: bool) -> bytes:
    """Return the contribution of one directory entry to the state."""
    if entry.is_symlink():
        try:
            there = entry.stat()
        except OSError:
            return b"broken link"
        target = f"link {there.st_mode} {there.st_size} {there.st_mtime_ns} {there.st_ino}"
        return os.fsencode(f"{target} {Path(entry.path).readlink()}")
    if entry.is_dir():
        return b"folder"
    if not entry.is_file():
        return b"neither"
    return f"{entry.stat().st_mode} {_digest(Path(entry.path))}".encode() if direct else b"file"


def _digest(file: Path) -> str:
    """Return the hash of a file's content; of a file that is too large to be read as source, its size."""
    size = file.stat().st_size
    return f"{size} bytes" if size > SIZE_LIMIT else hashlib.sha256(files.read_regular(file, SIZE_LIMIT)).hexdigest()


@cache
def _version(entry: RuleEntry) -> str:
    """Return a hash of the Python files of a rule's folder, and of what all rules depend on."""
    return _hash_files(_python_files(entry.path.parent), tool_digest())


@cache
def tool_digest() -> str:
    """Return a hash of what all rules depend on: interpreter, libraries, engine, SDK and the standard."""
    engine = Path(__file__).parents[2]
    below = (*(engine / room for room in _PACKAGES), engine.parent / "xpl")
    code = (path for start in below for folder, _, _ in os.walk(start) for path in _python_files(Path(folder)))
    content_files = (
        path for name in ("spec", "templates") for path in content.content_folder(name).rglob("*") if path.is_file()
    )
    versions = f"{__version__} {platform.python_implementation()} {platform.python_version()} {yaml.__version__}"
    return _hash_files((*code, *content_files), versions)


def _python_files(folder: Path) -> list[str]:
    return [f"{folder}/{name}" for name in os.listdir(folder) if name.endswith(".py")]  # noqa: PTH208 - much faster


def _hash_files(files: Iterable[Path | str], initial: str) -> str:
    state = hashlib.sha256(initial.encode())
    for file in sorted(str(file) for file in files):
        with open(file, "rb", buffering=0) as stream:  # noqa: PTH123 - much faster, and there are hundreds
            content = stream.readall()
        state.update(b"\0" + os.fsencode(os.path.basename(file)) + b"\0" + hashlib.sha256(content).digest())  # noqa: PTH119
    return state.hexdigest()


def _prune(folder: Path, limit: int = LIMIT) -> None:
    """Remove the least recently used records, and a fifth more, so that this runs rarely."""
    records = [Path(entry.path) for entry in os.scandir(folder) if entry.is_file(follow_symlinks=False)]
    if len(records) <= limit:
        return
    for path in sorted(records, key=os.path.getmtime)[: len(records) - limit * 4 // 5]:
        path.unlink(missing_ok=True)
