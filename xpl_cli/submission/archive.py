"""A bundle as one file: a zip archive whose bytes follow from its content, and that is opened with suspicion."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import stat
import tempfile
import zipfile
from pathlib import Path, PurePosixPath
from typing import IO, TYPE_CHECKING, Any, cast

from xpl_cli.basics import files
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.basics.sizes import format_size

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The first time of the zip format: an archive does not reveal when it was made."""
_MODE = stat.S_IFREG | 0o644
_UNIX = 3
_MOST_FILES = 100_000
_MOST_DIRECTORY = 64 << 20
_LONGEST, _LONGEST_PART, _DEEPEST = 512, 200, 32
"""Bytes of a name and of a part of it, and parts: what every file system bears below a folder of its own."""
_BLOCK = 1 << 20
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def write(path: Path, content: Mapping[str, Path | bytes]) -> str:
    """Write an archive atomically, and return the SHA-256 of its bytes.

    Order, times and modes are always the same, so that equal content gives equal bytes (under one version of zlib).

    Args:
        path: of the archive.
        content: name, with / between folders, to a file of this machine or the content itself.

    Raises:
        UserError: it cannot be written.
    """
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:64]}.")
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror}") from None
    partial = Path(name)
    try:
        with os.fdopen(handle, "wb") as stream, zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for entry in sorted(content):
                _add(archive, entry, content[entry])
        with partial.open("rb") as written:
            digest = hashlib.file_digest(written, "sha256").hexdigest()
        partial.chmod(0o644)  # mkstemp makes files private
        partial.replace(path)
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror or error}") from None
    finally:
        partial.unlink(missing_ok=True)
    return digest


def _add(archive: zipfile.ZipFile, name: str, content: Path | bytes) -> None:
    if not _is_plain_name(name):
        raise UserError(f"a file called {name!r} cannot be part of a bundle: its name would not do on every system")
    entry = zipfile.ZipInfo(name, _EPOCH)
    entry.compress_type, entry.create_system, entry.external_attr = zipfile.ZIP_DEFLATED, _UNIX, _MODE << 16
    if isinstance(content, bytes):
        archive.writestr(entry, content)
        return
    entry.file_size = content.stat().st_size
    with content.open("rb") as source, archive.open(entry, "w") as stream:
        shutil.copyfileobj(source, stream, _BLOCK)


def unpack(path: Path, folder: Path, *, limit: int) -> dict[str, str]:
    """Extract an archive into an empty folder, and return the SHA-256 of each file by its name.

    Args:
        path: the archive.
        folder: destination.
        limit: most bytes in all.

    Raises:
        NotFoundError: there is no such archive.
        UserError: it is invalid, damaged, too large, or holds anything but files with plain names.
    """
    try:
        stream = files.open_regular(path, most=limit)
    except FileNotFoundError:
        raise NotFoundError(f"there is no bundle {path}") from None
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror or error}") from None
    with stream, _reading(path), zipfile.ZipFile(cast("IO[bytes]", _BoundedReader(stream))) as archive:
        entries = list(_checked_entries(archive, path, folder, limit))
        return {entry.filename: _extract(archive, entry, folder / entry.filename) for entry in entries}


class _BoundedReader:
    """A file whose single reads are limited in size.

    An archive announces the length of its directory, which zipfile reads at once and expands many times in memory.
    """

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream

    def read(self, size: int = -1) -> bytes:
        """Read up to so many bytes.

        Raises:
            BadZipFile: they are more than a list of files needs.
        """
        if size > _MOST_DIRECTORY:
            raise zipfile.BadZipFile("its list of files is too long")
        return self._stream.read(size)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Report errors while an archive is read as errors of the archive, or of the machine."""
    try:
        yield
    except (UserError, KeyboardInterrupt, MemoryError):
        raise
    except OSError as error:
        raise UserError(f"{path} cannot be unpacked: {error.strerror or error}", code=ExitCode.NOT_RUN) from None
    except Exception as error:  # noqa: BLE001 - damaged bytes lead zipfile and zlib to errors of a dozen kinds
        raise UserError(f"{path} is no bundle, or is damaged: {str(error) or type(error).__name__}") from None


def _checked_entries(archive: zipfile.ZipFile, path: Path, folder: Path, limit: int) -> Iterator[zipfile.ZipInfo]:
    """Yield the entries of an archive.

    Raises:
        UserError: one of them is not to be unpacked, or they are too many or too large.
    """
    entries = archive.infolist()
    total = sum(entry.file_size for entry in entries)
    if total > limit or len(entries) > _MOST_FILES:
        raise UserError(
            f"{path} would unpack to {format_size(total)} in {len(entries)} files, more than the limit of "
            f"{format_size(limit)}" + (f" or of {_MOST_FILES} files" if len(entries) > _MOST_FILES else ""),
            hint="raise it with --max-size" if total > limit else None,
        )
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if total > (free := shutil.disk_usage(existing).free):
        raise UserError(
            f"{path} would unpack to {format_size(total)}, and {folder} has {format_size(free)} free",
            hint="--unpack names a new folder elsewhere",
            code=ExitCode.NOT_RUN,
        )
    names: set[str] = set()
    folders: set[str] = set()
    for entry in entries:
        kind = stat.S_IFMT(entry.external_attr >> 16)
        is_plain = kind in (0, stat.S_IFREG) and entry.compress_type in _METHODS and not entry.flag_bits & 1
        above = {str(parent) for parent in PurePosixPath(entry.filename).parents}
        if (
            not is_plain
            or not _is_plain_name(entry.orig_filename)
            or entry.filename in names
            or entry.filename in folders
            or not names.isdisjoint(above)
        ):
            raise UserError(f"{path} holds {entry.orig_filename[:200]!r}: expected files with plain names, each once")
        names.add(entry.filename)
        folders |= above
        yield entry


def _is_plain_name(name: str) -> bool:
    """Return whether a name stays below the destination folder, on any system."""
    parts = name.split("/")
    return (
        name.isprintable()
        and "\\" not in name
        and ":" not in name
        and not {"", ".", ".."}.intersection(parts)
        and len(parts) <= _DEEPEST
        and len(name.encode()) <= _LONGEST
        and all(len(part.encode()) <= _LONGEST_PART for part in parts)
    )


def _extract(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, target: Path) -> str:
    """Write one file and return its digest; no more is read than the archive's directory says."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with archive.open(entry) as source, target.open("xb") as stream:
        return _copy_and_hash(source, stream)


def _copy_and_hash(source: IO[bytes], stream: IO[bytes]) -> str:
    digest = hashlib.sha256()
    while block := source.read(_BLOCK):
        digest.update(block)
        stream.write(block)
    return digest.hexdigest()
