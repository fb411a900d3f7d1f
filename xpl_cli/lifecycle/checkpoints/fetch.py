"""A checkpoint brought here, checked, and made what its name means in an adapter.

One of this machine stays where it is. One of the Hugging Face hub is brought by the hub's own client into its own
cache, which has the user's login, proxies and mirrors, and goes on with what was cut. Nothing is opened, unpacked or
loaded.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl.manifest import CheckpointFile
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.basics.extras import how_to_install
from xpl_cli.lifecycle.checkpoints.content import hash_checkpoint, list_files, sha256_of
from xpl_cli.lifecycle.checkpoints.specification import HUB, check_commit, digest_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.lifecycle.checkpoints.specification import CheckpointSpec


@dataclass(frozen=True)
class FetchedCheckpoint:
    """A checkpoint that is here.

    Attributes:
        path: its folder, or its one file.
        digest: of its content.
        state: "there" if nothing had to be brought, else "fetched".
        files: with their digests.
    """

    path: Path
    digest: str
    state: str
    files: tuple[CheckpointFile, ...]


@dataclass(frozen=True)
class CheckpointDifference:
    """What is not as policy.yml says.

    Attributes:
        path: of a file in the checkpoint; empty for all of it.
        what: missing, size or sha256.
        expected: by policy.yml.
        got: what is there.
    """

    path: str
    what: str
    expected: str | int | None
    got: str | int | None


def fetch(specification: CheckpointSpec, *, unverified: bool = False, force: bool = False) -> FetchedCheckpoint:
    """Bring a checkpoint unless it is here, and check it.

    Args:
        specification: the checkpoint.
        unverified: take what comes where policy.yml gives no digest, so that its author can write it there.
        force: have the hub's client bring it although it is here.

    Raises:
        NotFoundError: if it is not where it should be.
        UserError: if it cannot be had, or is not what the manifest says.
    """
    if specification.digest is None and not unverified:
        raise UserError(
            f"checkpoint {specification.name!r} has no sha256 in policy.yml: what arrives could not be checked",
            hint="--unverified fetches it all the same, once, and prints the sha256 to write there",
        )
    there = None if force else local_path(specification)
    if there is not None:
        digest, files = hash_local(specification, there)
        if not differences(specification, digest, files):
            return FetchedCheckpoint(there, digest, "there", files)
    path = _download(specification, force=force) if specification.kind == HUB else local_path(specification)
    if path is None:
        raise NotFoundError(f"checkpoint {specification.name!r}: there is no {specification.path}")
    digest, files = hash_local(specification, path)
    for one in differences(specification, digest, files):
        raise UserError(
            f"checkpoint {specification.name!r} is not the one that policy.yml means: {path / one.path}: {one.what}: "
            f"expected {one.expected}, got {one.got}",
            hint="the source has changed, or policy.yml is wrong; --force brings it again",
            code=ExitCode.FINDINGS,
        )
    return FetchedCheckpoint(path, digest, "fetched", files)


def local_path(specification: CheckpointSpec) -> Path | None:
    """Return where a checkpoint lies on this machine, or a part of it, unchecked; None if it is not here.

    Raises:
        UserError: if it is the hub's, and not pinned to a commit.
    """
    if specification.kind != HUB:
        return specification.path if specification.path.exists() else None
    check_commit(specification)
    try:
        return _snapshot(specification, local_files_only=True)
    except Exception:  # noqa: BLE001 - the client is not installed, or raises what its release raises for "not here"
        return None


def linked_checkpoint(specification: CheckpointSpec) -> Path | None:
    """Return what a checkpoint's name means in its adapter, None if nothing was fetched."""
    place = link_path(specification.base, specification.name)
    return place.resolve() if place.exists() else None


def hash_local(specification: CheckpointSpec, path: Path) -> tuple[str, tuple[CheckpointFile, ...]]:
    """Return the digest of a checkpoint, and its files with theirs: those that policy.yml lists, or all that are there.

    Args:
        specification: the checkpoint.
        path: where it lies.

    Raises:
        UserError: if a name in it cannot be written down.
    """
    if not specification.files:
        digest, found = hash_checkpoint(path)
        return digest, tuple(found)
    places = {file.path: path / file.path for file in specification.files}
    there = {name: place for name, place in places.items() if place.is_file()}
    files = tuple(CheckpointFile(name, sha256_of(place), place.stat().st_size) for name, place in there.items())
    return digest_of(files), files


def differences(
    specification: CheckpointSpec, digest: str, files: Sequence[CheckpointFile]
) -> list[CheckpointDifference]:
    """Return how a checkpoint that was read differs from policy.yml; nothing means that it is whole."""
    there = {file.path: file for file in files}
    found = []
    for file in specification.files:
        got = there.get(file.path)
        if got is None:
            found.append(CheckpointDifference(file.path, "missing", file.sha256, None))
        elif file.size not in (None, got.size):
            found.append(CheckpointDifference(file.path, "size", file.size, got.size))
        elif file.sha256 not in (None, got.sha256):
            found.append(CheckpointDifference(file.path, "sha256", file.sha256, got.sha256))
    size = sum(file.size or 0 for file in files)
    if not found and specification.size not in (None, size):
        found.append(CheckpointDifference("", "size", specification.size, size))
    if not found and specification.digest not in (None, digest):
        found.append(CheckpointDifference("", "sha256", specification.digest, digest))
    return found


def link_path(policy_dir: Path, name: str) -> Path:
    """Return the place in an adapter where the checkpoint resolver finds one by its name."""
    return policy_dir / sdk.CHECKPOINT_DIRECTORY / name


def link(policy_dir: Path, name: str, target: Path) -> Path:
    """Make `checkpoints/<name>` of an adapter a link to a checkpoint, in one step.

    Raises:
        UserError: if something else is there, or nothing can be written there.
    """
    place = link_path(policy_dir, name)
    target = target.absolute()
    if place.absolute() == target:
        return place
    if place.exists() and not place.is_symlink():
        raise UserError(f"{place} is there already and no link: it stays, and is what ckpt_name {name!r} means")
    if place.is_symlink() and place.readlink() == target:
        return place
    try:
        place.parent.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=place.parent, prefix=".") as scratch:
            fresh = Path(scratch) / name
            fresh.symlink_to(target)
            fresh.replace(place)
    except OSError as error:
        raise UserError(f"{place} cannot be written: {error.strerror}", code=ExitCode.NOT_RUN) from None
    return place


def _download(specification: CheckpointSpec, *, force: bool) -> Path:
    """Have the hub's client bring a checkpoint, and return where it lies in the client's cache."""
    try:
        path = _snapshot(specification, force_download=force)
    except ImportError as error:
        raise UserError(
            f"checkpoint {specification.name!r} is on the Hugging Face hub, whose client cannot be imported: {error}",
            hint=f"{how_to_install('hub')}, or give a path of this machine as its source",
            code=ExitCode.NOT_RUN,
        ) from None
    except Exception as error:  # noqa: BLE001 - the client raises errors of several libraries, and new ones with releases
        lines = str(error).strip().splitlines() or [""]
        raise UserError(
            f"{specification.source} cannot be had from the hub: {type(error).__name__}: {lines[0]:.200}",
            hint="run the same command again: it goes on where it stopped; a private repository needs `hf auth login`",
            code=ExitCode.NOT_RUN,
        ) from None
    if not path.is_dir() or not list_files(path):
        raise NotFoundError(f"{specification.source} has no files at {specification.revision}")
    return path


def _snapshot(specification: CheckpointSpec, *, local_files_only: bool = False, force_download: bool = False) -> Path:
    """Return the folder of the hub's cache that a checkpoint is, through the hub's client."""
    import huggingface_hub

    owner, name, *below = specification.source.removeprefix(f"{HUB}://").split("/")
    folder = "".join(f"{part}/" for part in below)
    root = huggingface_hub.snapshot_download(
        f"{owner}/{name}",
        revision=specification.revision,
        allow_patterns=[folder + file.path for file in specification.files] or [f"{folder}*"],
        local_files_only=local_files_only,
        force_download=force_download,
    )
    return Path(root) / folder
