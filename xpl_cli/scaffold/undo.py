"""Changes of a package that can be taken back: what is overwritten is kept first, in the package itself.

Until all is written, the record says so: whoever was killed in the middle left everything that is needed to bring the
package back, and the next change does so first. Works without version control.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from xpl_cli.basics import atomic
from xpl_cli.basics.errors import UserError
from xpl_cli.scaffold.lock import digest
from xpl_cli.standard.schemas import FOLDER

PATH = f"{FOLDER}/undo"
_RECORD: Final = "record.json"
_FILES: Final = "files"
_WRITING, _DONE = "writing", "done"
_SCRIPT, _PLAIN = 0o755, 0o644


@dataclass(frozen=True)
class Change:
    """A file before and after; None where there is none."""

    name: str
    before: bytes | None
    after: bytes | None


def apply(folder: Path, changes: Sequence[Change], what: str) -> None:
    """Change files of a package, all of them or none, so that `take_back` can undo it.

    Args:
        folder: the package.
        changes: what changes; a file whose content is not `before` any more is not touched.
        what: the change in a few words.

    Raises:
        UserError: if a file changed meanwhile or cannot be written; then all are as they were.
    """
    recover(folder)
    for change in changes:
        if _content(folder / change.name) != change.before:
            raise UserError(f"{folder / change.name} changed meanwhile: nothing was written", hint="run again")
    try:
        _keep(folder, changes, what)
        try:
            for change in changes:
                _put(folder / change.name, change.after)
        except BaseException:
            recover(folder)
            raise
        _note(folder, changes, what, _DONE)
    except OSError as error:
        where = f" ({error.filename})" if error.filename else ""
        raise UserError(f"{folder} cannot be written: {error.strerror or error}{where}") from None


def recover(folder: Path) -> bool:
    """Bring a package back if a change of it was cut off; tell whether it was."""
    record = _cut_off(folder)
    if record is None:
        return False
    _restore(folder, record)
    return True


def is_cut_off(folder: Path) -> bool:
    """Tell whether a change of a package was cut off, so that it is neither as before nor as after."""
    return _cut_off(folder) is not None


def take_back(folder: Path, *, force: bool = False) -> tuple[str, list[str]]:
    """Undo the last change of a package.

    Args:
        folder: the package.
        force: also where files were edited since; those edits are lost.

    Returns:
        what it was, and the files that are as they were before.

    Raises:
        UserError: if there is nothing to undo, or files were edited since.
    """
    record = _record(folder)
    if record is None:
        raise UserError(f"{folder} holds no change that could be undone")
    edited = [
        entry["name"]
        for entry in record["files"]
        if _digest(folder / entry["name"]) not in (entry["before"], entry["after"])
    ]
    if edited and not force and record["state"] == _DONE:
        raise UserError(
            f"{', '.join(edited)} in {folder} changed since the update: undoing it would lose that",
            hint=f"--force does so all the same; {folder / PATH / _FILES} holds what was there before",
        )
    _restore(folder, record)
    return record["what"], [entry["name"] for entry in record["files"]]


def _keep(folder: Path, changes: Sequence[Change], what: str) -> None:
    """Write down what the changes overwrite; only the whole record takes the place of an earlier one."""
    target = folder / PATH
    with atomic.replaced_folder(target) as staging:
        # Nothing of this belongs into version control, whatever the package's own rules are.
        (staging / ".gitignore").write_text("*\n")
        for change in changes:
            if change.before is not None:
                kept = staging / _FILES / change.name
                kept.parent.mkdir(parents=True, exist_ok=True)
                kept.write_bytes(change.before)
        (staging / _RECORD).write_bytes(_text(folder, changes, what, _WRITING))


def _note(folder: Path, changes: Sequence[Change], what: str, state: str) -> None:
    modes = _record(folder)
    text = _text(folder, changes, what, state, modes)
    atomic.write_file(folder / PATH / _RECORD, text)


def _text(
    folder: Path, changes: Sequence[Change], what: str, state: str, earlier: dict[str, Any] | None = None
) -> bytes:
    """Return the record of a change; modes are those from before it."""
    modes = {entry["name"]: entry["mode"] for entry in (earlier or {"files": ()})["files"]}
    files = [
        {
            "name": change.name,
            "before": None if change.before is None else digest(change.before),
            "after": None if change.after is None else digest(change.after),
            "mode": modes.get(change.name, _mode(folder / change.name)),
        }
        for change in changes
    ]
    record = {"schema": "xpl.undo/1", "what": what, "state": state, "files": files}
    return f"{json.dumps(record, indent=2)}\n".encode()


def _record(folder: Path) -> dict[str, Any] | None:
    path = folder / PATH / _RECORD
    if not path.is_file():
        return None
    try:
        record: dict[str, Any] = json.loads(path.read_bytes())
        for key in ("what", "state", "files"):
            record[key]
    except (OSError, ValueError, TypeError, KeyError):
        raise UserError(f"{path} cannot be read", hint=f"remove {folder / PATH} if nothing is to be undone") from None
    return record


def _cut_off(folder: Path) -> dict[str, Any] | None:
    record = _record(folder)
    return record if record is not None and record["state"] == _WRITING else None


def _restore(folder: Path, record: dict[str, Any]) -> None:
    """Put back what was there, then forget the change; whoever is interrupted here can do it again."""
    for entry in record["files"]:
        kept = folder / PATH / _FILES / entry["name"]
        before = kept.read_bytes() if entry["before"] is not None else None
        _put(folder / entry["name"], before, entry["mode"])
    shutil.rmtree(folder / PATH)
    if not any((folder / FOLDER).iterdir()):
        (folder / FOLDER).rmdir()


def _put(path: Path, content: bytes | None, mode: int | None = None) -> None:
    if content is None:
        path.unlink(missing_ok=True)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    if mode is None:
        mode = _mode(path) or (_SCRIPT if path.suffix == ".sh" else _PLAIN)
    atomic.write_file(path, content, mode)


def _mode(path: Path) -> int | None:
    return path.stat().st_mode & 0o7777 if path.is_file() else None


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.is_file() else None


def _digest(path: Path) -> str | None:
    content = _content(path)
    return None if content is None else digest(content)
