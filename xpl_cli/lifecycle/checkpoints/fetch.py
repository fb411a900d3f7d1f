"""Bringing a checkpoint into the store, finding it there, and checking that it is still what it was."""

from __future__ import annotations

import shutil
import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.sizes import told_size
from xpl_cli.lifecycle.checkpoints import store as stores
from xpl_cli.lifecycle.checkpoints.specification import digest_of
from xpl_cli.lifecycle.checkpoints.transfer import Bounds

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from xpl_cli.basics.progress import Progress
    from xpl_cli.lifecycle.checkpoints.sources import Source
    from xpl_cli.lifecycle.checkpoints.specification import File, Specification
    from xpl_cli.lifecycle.checkpoints.store import Staging, Store

_SPARE = 64 << 20
"""Room that is left on the disk."""
_EVERY_S = 0.2
_WAITS = "{}: another process fetches it; waiting"


@dataclass(frozen=True)
class Fetched:
    """A checkpoint in the store.

    Attributes:
        path: its folder, or its one file.
        digest: of its content.
        state: "there" if nothing had to be brought, else "fetched".
        files: with their digests; empty if nothing had to be brought.
    """

    path: Path
    digest: str
    state: str
    files: tuple[File, ...] = ()


@dataclass(frozen=True)
class Order:
    """How a checkpoint is to be fetched.

    Attributes:
        limit: most bytes in all.
        unverified: take what comes where policy.yml gives no digest, so that its author can write it there.
        again: bring it although it is there.
        progress: where to say what is being done.
    """

    limit: int
    progress: Progress
    unverified: bool = False
    again: bool = False


def fetch(specification: Specification, store: Store, source: Callable[[], Source], order: Order) -> Fetched:
    """Bring a checkpoint into the store unless it is there.

    Args:
        specification: the checkpoint.
        store: where it is kept.
        source: makes the source that it comes from; called only if it is needed.
        order: how.

    Raises:
        UserError: if it cannot be had, is too large, or is not what the manifest says; nothing is then in the store
            that was not there before.
    """
    if specification.digest is None and not order.unverified:
        raise UserError(
            f"checkpoint {specification.name!r} has no sha256 in policy.yml: what arrives could not be checked",
            hint="--unverified fetches it all the same, once, and prints the sha256 to write there",
        )
    there = None if order.again else _there(specification, store)
    if there is not None:
        return there
    with store.staging(_key(specification), lambda: order.progress.step(_WAITS.format(specification.name))) as staging:
        there = None if order.again else _there(specification, store)  # another process may have brought it meanwhile
        if there is not None:
            return there
        origin = source()
        listing = _merged(specification.files, origin.listing())
        _check_room(specification, listing, order.limit, staging, store)
        files = _Arrival(specification, origin, staging, order).bring(listing)
        digest = files[0].sha256 or "" if specification.file_name is not None else digest_of(files)
        if specification.digest not in (None, digest):
            staging.clear()
            raise UserError(
                f"checkpoint {specification.name!r} is not the one that policy.yml means: its sha256 is {digest}, "
                f"expected {specification.digest}",
                hint="the source has changed, or policy.yml is wrong; nothing was kept",
                code=ExitCode.FINDINGS,
            )
        store.place(staging, digest)
    path = store.content(digest, specification.file_name)
    if path is None:
        raise UserError(f"{store.folder(digest)} went away while it was fetched", code=ExitCode.NOT_RUN)
    return Fetched(path, digest, "fetched", tuple(files))


def located(specification: Specification, store: Store) -> Path | None:
    """Return where a checkpoint lies in the store, None if it was not fetched.

    One whose digest is not declared is known by the link that an adapter has to it.
    """
    if specification.digest is not None:
        return store.content(specification.digest, specification.file_name)
    place = stores.linked(specification.base, specification.name)
    inside = place.is_symlink() and place.exists() and place.resolve().is_relative_to(store.root.resolve())
    return place.resolve() if inside else None


def verify(specification: Specification, path: Path, store: Store) -> list[dict[str, Any]]:
    """Read a checkpoint again, and return how it differs from its digests; nothing means that it is whole.

    Args:
        specification: the checkpoint.
        path: where it lies.
        store: where it is kept: under the digest of its content.
    """
    digest, files = stores.hashed(path)
    found = {file.path: file for file in files}
    wanted = {file.path: file for file in specification.files}
    differences: list[dict[str, Any]] = []
    for name, file in wanted.items():
        if name not in found:
            differences.append(_difference(name, "missing", file.sha256, None))
        elif file.size is not None and file.size != found[name].size:
            differences.append(_difference(name, "size", file.size, found[name].size))
        elif file.sha256 and file.sha256 != found[name].sha256:
            differences.append(_difference(name, "sha256", file.sha256, found[name].sha256))
    if wanted:
        extra = sorted(found.keys() - wanted.keys())
        differences += [_difference(name, "extra", None, found[name].sha256) for name in extra]
    expected = specification.digest or path.resolve().relative_to(store.root.resolve()).parts[0]
    if not differences and digest != expected:
        differences.append(_difference("", "sha256", expected, digest))
    return differences


def _difference(path: str, what: str, expected: object, got: object) -> dict[str, Any]:
    return {"path": path, "what": what, "expected": expected, "got": got}


def _there(specification: Specification, store: Store) -> Fetched | None:
    if specification.digest is None:
        return None
    path = store.content(specification.digest, specification.file_name)
    return None if path is None else Fetched(path, specification.digest, "there")


def _key(specification: Specification) -> str:
    """Return what tells one checkpoint on its way from another: its digest, or where it comes from."""
    origin = f"{specification.source}\0{specification.revision}\0{[file.path for file in specification.files]}"
    return specification.digest or f"unverified\0{specification.base}\0{origin}"


def _merged(declared: Sequence[File], listed: Sequence[File]) -> list[File]:
    """Return the listed files, where policy.yml says more of one with that."""
    known = {file.path: file for file in declared}
    return [
        file
        if (own := known.get(file.path)) is None
        else replace(file, sha256=own.sha256 or file.sha256, size=file.size if own.size is None else own.size)
        for file in listed
    ]


def _check_room(
    specification: Specification, listing: Sequence[File], limit: int, staging: Staging, store: Store
) -> None:
    """Raise if the files are more than was declared, than is allowed, or than there is room for."""
    name = repr(specification.name)
    sizes = [file.size for file in listing]
    known = sum(size or 0 for size in sizes)
    total = max(known, specification.size or 0)
    if None not in sizes and specification.size not in (None, known):
        raise UserError(
            f"checkpoint {name} has {known} bytes at its source, but policy.yml says {specification.size}",
            code=ExitCode.FINDINGS,
        )
    if total > limit:
        raise UserError(
            f"checkpoint {name} has {told_size(total)}, more than the limit of {told_size(limit)}",
            hint="raise it with --max-size",
        )
    arrived = sum(
        path.stat().st_size for folder in (staging.whole, staging.parts) for path in folder.rglob("*") if path.is_file()
    )
    needed = max(total - arrived, 0)
    free = shutil.disk_usage(store.root).free
    if needed and needed + _SPARE > free:
        raise UserError(
            f"checkpoint {name} needs {told_size(needed)}, and {told_size(free)} are free in {store.root}",
            hint="make room, or choose another disk with --cache",
            code=ExitCode.NOT_RUN,
        )


@dataclass
class _Arrival:
    """The files of one checkpoint, as they come in."""

    specification: Specification
    source: Source
    staging: Staging
    order: Order
    _total: int = 0
    _said: float = field(default=0.0)

    def bring(self, listing: Sequence[File]) -> list[File]:
        """Bring all files that are not there yet, and return them with their digests."""
        self._forget_others({file.path: file for file in listing})
        files = []
        for file in listing:
            self.order.progress.step(f"{self.specification.name}: {file.path}")
            whole = self.staging.whole / file.path
            found = self._checked(file, whole) if whole.is_file() else None
            if found is None:
                found = self._one(file, whole)
            self._total += found.size or 0
            files.append(found)
        return files

    def _one(self, file: File, whole: Path) -> File:
        part = self.staging.parts / file.path
        for folder in (part.parent, whole.parent):
            folder.mkdir(parents=True, exist_ok=True)
        size = self.specification.size if file.size is None and self.specification.file_name else file.size
        bounds = Bounds(size, self.order.limit - self._total)
        for _ in range(2):
            resumed = self.source.bring(file, part, bounds, lambda there: self._say(file, size, there))
            found = self._checked(file, part)
            if found is not None:
                part.replace(whole)
                return found
            got = stores.sha256_of(part)
            part.unlink()
            if not resumed:  # what was there before may have been of something else
                break
        raise UserError(
            f"{file.path} of checkpoint {self.specification.name!r} has the sha256 {got}, expected {file.sha256}",
            hint="the source has changed, or policy.yml is wrong; the file was thrown away",
            code=ExitCode.FINDINGS,
        )

    def _checked(self, file: File, path: Path) -> File | None:
        """Return the file with its digest, None if it is not what it should be."""
        expected = file.sha256 or (self.specification.digest if self.specification.file_name else None)
        found = replace(file, sha256=stores.sha256_of(path), size=path.stat().st_size)
        return found if expected in (None, found.sha256) else None

    def _forget_others(self, wanted: Mapping[str, File]) -> None:
        """Remove what arrived in earlier attempts and does not belong to the checkpoint any more."""
        for path in [path for path in self.staging.whole.rglob("*") if path.is_file()]:
            if path.relative_to(self.staging.whole).as_posix() not in wanted:
                path.unlink()

    def _say(self, file: File, size: int | None, there: int) -> None:
        now = time.monotonic()
        if now - self._said >= _EVERY_S:
            self._said = now
            share = f" of {told_size(size)}, {there / size:.0%}" if size else ""
            self.order.progress.detail(f"{self.specification.name}: {file.path}: {told_size(there)}{share}")
