"""Files and digests of a checkpoint."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from xpl.manifest import CheckpointFile
from xpl_cli.basics.errors import UserError
from xpl_cli.lifecycle.checkpoints.specification import check_path, digest_of


def list_files(folder: Path) -> list[CheckpointFile]:
    """Return the files below a folder with their sizes, sorted; names that begin with a dot are skipped.

    Raises:
        UserError: if it contains a link to a folder, or an invalid name.
    """
    files = []
    for parent, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in folders:
            if (Path(parent) / name).is_symlink():
                raise UserError(f"{Path(parent) / name} is a link to a folder, which is not followed")
        for name in sorted(names):
            path = Path(parent) / name
            if not name.startswith(".") and path.is_file():
                relative = check_path(path.relative_to(folder).as_posix(), str(folder))
                files.append(CheckpointFile(relative, size=path.stat().st_size))
    return files


def sha256_of(path: Path) -> str:
    """Return the digest of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def hash_checkpoint(path: Path) -> tuple[str, list[CheckpointFile]]:
    """Return the digest of a checkpoint, and its files with their digests."""
    if path.is_file():
        digest = sha256_of(path)
        return digest, [CheckpointFile(path.name, digest, path.stat().st_size)]
    files = [CheckpointFile(file.path, sha256_of(path / file.path), file.size) for file in list_files(path)]
    return digest_of(files), files
