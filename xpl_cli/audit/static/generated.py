"""Generated files of a package: their lock, which were edited, and their rendered content."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl_cli.audit.rules.model import Edit
from xpl_cli.scaffold import lock
from xpl_cli.standard import schemas

if TYPE_CHECKING:
    from xpl_cli.audit.static.source import Source

LOCK = lock.PATH
"""The file that lists the generated files."""


def read(source: Source) -> lock.Lock:
    """Return the parsed lock of a package.

    Raises:
        UserError: if it is invalid.
    """
    return lock.parse(source.text(LOCK), LOCK)


def edited_files(source: Source, lock_file: lock.Lock) -> list[str]:
    """Return the generated files that exist and were edited; `free` files may be edited."""
    names = [name for name in lock_file.generated if name not in lock_file.free and source.has(name)]
    return [name for name in names if lock.digest(source.text(name).encode()) != lock_file.generated[name]]


def rendered_files(source: Source) -> dict[str, bytes]:
    """Return the rendered content of a package's files, as far as it is stored."""
    for_editors = {schemas.path(name): schemas.render(name) for name in schemas.MANIFESTS}
    try:
        files = lock.parse_rendered(source.text(lock.RENDERED)) if source.has(lock.RENDERED) else {}
    except (ValueError, AttributeError):
        files = {}
    return {**files, **for_editors}


def restore_edit(source: Source, name: str, content: bytes | None, digest: str) -> Edit | None:
    """Return the edit that restores a file; None if its rendered content is unknown.

    Args:
        source: the package.
        name: the file.
        content: the rendered content, or None.
        digest: digest of the rendered content in the lock.
    """
    if content is None or lock.digest(content) != digest:
        return None
    lines = source.text(name).split("\n")
    return Edit(name, 1, 1, len(lines), len(lines[-1]) + 1, content.decode())
