"""The rules that always apply: a block of AGENTS.md between two markers, and CLAUDE.md, which imports it.

Text outside the block is never changed. An existing CLAUDE.md belongs to the user and is not changed.
"""

from __future__ import annotations

import re
import stat
from pathlib import Path
from typing import Final

from xpl_cli.agents.skills.installation import Condition, InstallResult
from xpl_cli.basics import atomic
from xpl_cli.basics.content import content_folder

FILE: Final = "AGENTS.md"
CLAUDE_FILE: Final = "CLAUDE.md"
IMPORT: Final = f"@{FILE}"

_MODE: Final = 0o644
_UNDECODED: Final = "surrogateescape"
"""Bytes that are not UTF-8 are preserved."""

_BEGIN: Final = "<!-- xpl: begin. Written by `xpl skills install`; what you write belongs outside. -->"
_END: Final = "<!-- xpl: end -->"
_BLOCK: Final = re.compile(r"<!-- xpl: begin\b.*?<!-- xpl: end -->", re.DOTALL)
_IMPORTS: Final = re.compile(rf"(?<![\w`])@(\.\.?/)?{re.escape(FILE)}\b")
_MEMORIES: Final = (CLAUDE_FILE, f".claude/{CLAUDE_FILE}")
"""Files from which Claude Code reads a project's instructions."""


def block() -> str:
    """Return the block of this version, with its markers."""
    text = (content_folder("templates") / "agents" / FILE).read_text(encoding="utf-8").strip()
    return f"{_BEGIN}\n\n{text}\n\n{_END}"


def condition(project: Path) -> Condition:
    """Compare the block in a project's AGENTS.md with that of this version."""
    match = _BLOCK.search(_read(project / FILE))
    if match is None:
        return Condition.ABSENT
    return Condition.CURRENT if match.group() == block() else Condition.STALE


def is_imported(project: Path) -> bool:
    """Tell whether Claude Code reads a project's AGENTS.md."""
    files = [project / name for name in _MEMORIES if (project / name).is_file()]
    return any(_IMPORTS.search(_read(path)) or path.resolve() == (project / FILE).resolve() for path in files)


def put(project: Path, *, dry_run: bool = False) -> list[InstallResult]:
    """Write the block into AGENTS.md, and a CLAUDE.md that imports it if there is none."""
    return [_put_block(project / FILE, dry_run=dry_run), _put_import(project, dry_run=dry_run)]


def _put_block(path: Path, *, dry_run: bool) -> InstallResult:
    old = _read(path)
    if _BLOCK.search(old):
        new = _BLOCK.sub(lambda _: block(), old, count=1)
        state = "renewed"
    else:
        new = f"{old.rstrip()}\n\n{block()}\n".lstrip()
        state = "written"
    if new == old:
        return InstallResult(path, "unchanged")
    if not dry_run:
        target = path.resolve()  # the target of a link
        mode = stat.S_IMODE(target.stat().st_mode) if target.exists() else _MODE
        atomic.write_file(target, new.encode(errors=_UNDECODED), mode)
    return InstallResult(path, state)


def _put_import(project: Path, *, dry_run: bool) -> InstallResult:
    path = project / CLAUDE_FILE
    if is_imported(project):
        return InstallResult(path, "unchanged")
    if path.exists() or path.is_symlink():
        return InstallResult(path, "left", f"it is yours; add the line {IMPORT}, or Claude Code does not read {FILE}")
    if not dry_run:
        atomic.write_file(path, f"{IMPORT}\n".encode(), _MODE)
    return InstallResult(path, "written")


def _read(path: Path) -> str:
    # Read as bytes to preserve line ends.
    return path.read_bytes().decode(errors=_UNDECODED) if path.is_file() else ""
