"""The files of a checkpoint, and the digests by which they are known again."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from xpl.manifest import CheckpointFile
from xpl_cli.basics.errors import UserError
from xpl_cli.lifecycle.checkpoints.specification import check_path, digest_of


def list_files(folder: Path) -> list[CheckpointFile]:
    """Return the files below a folder with their sizes, sorted; what begins with a dot is no part of a checkpoint.

    Raises:
        UserError: if a folder in it is a link, which may lead anywhere, or a name cannot be written down.
    """
    found = []
    for place, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in folders:
            if (Path(place) / name).is_symlink():
                raise UserError(f"{Path(place) / name} is a link to a folder, which is not followed")
        for name in sorted(names):
            path = Path(place) / name
            if not name.startswith(".") and path.is_file():
                relative = check_path(path.relative_to(folder).as_posix(), str(folder))
                found.append(CheckpointFile(relative, size=path.stat().st_size))
    return found


def sha256_of(path: Path) -> str:
    """Return the digest of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def hash_checkpoint(path: Path) -> tuple[str, list[CheckpointFile]]:
    """Return the digest of a checkpoint and its files with theirs."""
    if path.is_file():
        found = sha256_of(path)
        return found, [CheckpointFile(path.name, found, path.stat().st_size)]
    files = [CheckpointFile(file.path, sha256_of(path / file.path), file.size) for file in list_files(path)]
    return digest_of(files), files
