"""Files of a package that were generated: what its lock says of them, which were edited, and how they were rendered."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl_cli.audit.rules.model import Edit
from xpl_cli.scaffold import lock
from xpl_cli.standard import schemas

if TYPE_CHECKING:
    from xpl_cli.audit.static.source import Source

LOCK = lock.PATH
"""The file that tells which files are generated."""


def read(source: Source) -> lock.Lock:
    """Return what the lock of a package says.

    Raises:
        UserError: if it is not what xpl wrote.
    """
    return lock.parse(source.text(LOCK), LOCK)


def edited_files(source: Source, lock_file: lock.Lock) -> list[str]:
    """Return the generated files that are there and not as they were rendered; those that are free may be otherwise."""
    names = [name for name in lock_file.generated if name not in lock_file.free and source.has(name)]
    return [name for name in names if lock.digest(source.text(name).encode()) != lock_file.generated[name]]


def rendered_files(source: Source) -> dict[str, bytes]:
    """Return the files of a package as they were rendered, as far as it still tells."""
    for_editors = {schemas.path(name): schemas.render(name) for name in schemas.MANIFESTS}
    try:
        files = lock.parse_rendered(source.text(lock.RENDERED)) if source.has(lock.RENDERED) else {}
    except (ValueError, AttributeError):
        files = {}
    return {**files, **for_editors}


def restore_edit(source: Source, name: str, content: bytes | None, digest: str) -> Edit | None:
    """Return the edit that brings a file back as it was; None where nobody knows how that was.

    Args:
        source: the package.
        name: the file.
        content: how it was rendered, None where nothing tells.
        digest: of how it was rendered, as the lock has it.
    """
    if content is None or lock.digest(content) != digest:
        return None
    lines = source.text(name).split("\n")
    return Edit(name, 1, 1, len(lines), len(lines[-1]) + 1, content.decode())
