"""Where checkpoints come from: a folder or file of this machine, the web, the Hugging Face hub.

A source lists its files and brings one of them. Nothing that it brings is opened, unpacked or loaded here.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol
from urllib.parse import quote, urlsplit

from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.basics.extras import how_to_install
from xpl_cli.lifecycle.checkpoints import store, transfer
from xpl_cli.lifecycle.checkpoints.specification import HUB, File, check_commit, check_path

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from xpl_cli.lifecycle.checkpoints.specification import Specification
    from xpl_cli.lifecycle.checkpoints.transfer import Bounds, Patience

_BLOCK = 1 << 22


class Source(Protocol):
    """Where a checkpoint is."""

    def listing(self) -> list[File]:
        """Return the files of the checkpoint, with what is known of each.

        Raises:
            UserError: if they cannot be listed.
        """
        ...

    def bring(self, file: File, part: Path, bounds: Bounds, say: Callable[[int], None]) -> bool:
        """Write one file to `part`, and tell whether that goes on with what was there, and so may have to be repeated.

        Raises:
            UserError: if it cannot be had.
        """
        ...


def source_of(specification: Specification, *, mirror: Path | None = None, patience: Patience | None = None) -> Source:
    """Return the source of a checkpoint.

    Args:
        specification: the checkpoint.
        mirror: folder that has the checkpoints under their digests or names; then nothing else is asked.
        patience: how long a transfer keeps trying.

    Raises:
        NotFoundError: if the mirror does not have it.
        UserError: if the hub's client is needed and not installed, or the checkpoint is not pinned.
    """
    if mirror is not None:
        return FolderSource(_in_mirror(specification, mirror), specification.file_name, specification.files)
    if specification.kind == "path":
        return FolderSource(specification.path, specification.file_name, specification.files)
    if specification.kind == "web":
        return WebSource(specification, patience)
    return HubSource(specification)


@dataclass(frozen=True)
class FolderSource:
    """A folder of this machine, or one file.

    Attributes:
        path: the folder or file.
        file_name: what the one file is called that the checkpoint is, None if it is a folder.
        files: those that belong to it; all that are there by default.
    """

    path: Path
    file_name: str | None
    files: tuple[File, ...] = ()

    def listing(self) -> list[File]:
        """Return the files that are there."""
        if not self.path.exists():
            raise NotFoundError(f"there is no {self.path}")
        if self.file_name is not None:
            return [File(self.file_name, size=self._place(self.file_name).stat().st_size)]
        if not self.path.is_dir():
            raise UserError(f"{self.path} is a file: expected a folder with the files of the checkpoint")
        return list(self.files) or store.contents(self.path)

    def bring(self, file: File, part: Path, bounds: Bounds, say: Callable[[int], None]) -> bool:
        """Copy one file, whole."""
        place = self._place(file.path)
        try:
            bounds.check(place.stat().st_size, str(place))
            with place.open("rb") as given, part.open("wb") as stream:
                while block := given.read(_BLOCK):
                    stream.write(block)
                    say(stream.tell())
                stream.flush()
                os.fsync(stream.fileno())
        except FileNotFoundError:
            raise NotFoundError(f"there is no {place}") from None
        except OSError as error:
            raise UserError(f"{place} cannot be copied: {error.strerror}", code=ExitCode.NOT_RUN) from None
        return False

    def _place(self, path: str) -> Path:
        return self.path if self.path.is_file() else self.path / path


@dataclass(frozen=True)
class WebSource:
    """Files at an address.

    Attributes:
        specification: the checkpoint.
        patience: how long a transfer keeps trying.
    """

    specification: Specification
    patience: Patience | None = None

    def listing(self) -> list[File]:
        """Return what the specification lists, or the one file that it is."""
        name = self.specification.file_name
        return list(self.specification.files) if name is None else [File(name)]

    def bring(self, file: File, part: Path, bounds: Bounds, say: Callable[[int], None]) -> bool:
        """Download one file, or the rest of it."""
        address = urlsplit(self.specification.source)
        if self.specification.file_name is None:
            address = address._replace(path=address.path + quote(file.path))
        return transfer.download(address.geturl(), part, bounds, say, self.patience)


@dataclass(frozen=True)
class HubSource:
    """A repository of the Hugging Face hub, through its own client, which has the user's login, proxies and mirrors."""

    specification: Specification
    _client: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_commit(self.specification)
        object.__setattr__(self, "_client", _hub_client(self.specification.name))

    def listing(self) -> list[File]:
        """Return the files of the repository at its commit, or those below the folder that the source names."""
        repository, folder = self._place()
        try:
            told = self._client.HfApi().repo_info(
                repository, revision=self.specification.revision, files_metadata=True, timeout=60.0
            )
        except Exception as error:  # noqa: BLE001 - the client raises errors of several libraries, and new ones with releases
            raise self._failed(error) from None
        below = [entry for entry in told.siblings or () if entry.rfilename.startswith(folder)]
        known = {entry.rfilename.removeprefix(folder): entry for entry in below}
        wanted = self.specification.files or [File(name) for name in sorted(known) if not _is_hidden(name)]
        missing = [file.path for file in wanted if file.path not in known]
        if missing or not wanted:
            what = missing[0] if missing else "files"
            raise NotFoundError(f"{self.specification.source} has no {what} at {self.specification.revision}")
        return [_completed(file, known[file.path]) for file in wanted]

    def bring(self, file: File, part: Path, bounds: Bounds, say: Callable[[int], None]) -> bool:
        """Have the client bring one file; it goes on with what it brought before by itself."""
        repository, folder = self._place()
        scratch = part.with_name(f"{part.name}.hub")
        try:
            brought = self._client.hf_hub_download(
                repository, folder + file.path, revision=self.specification.revision, local_dir=scratch
            )
        except Exception as error:  # noqa: BLE001 - see above
            raise self._failed(error) from None
        os.replace(brought, part)  # noqa: PTH105 - the client returns a text
        shutil.rmtree(scratch)
        size = part.stat().st_size
        bounds.check(size, f"{self.specification.source}/{file.path}")
        say(size)
        return False

    def _place(self) -> tuple[str, str]:
        """Return the repository, and the folder in it that the checkpoint is, empty or with a / at its end."""
        owner, name, *folder = self.specification.source.removeprefix(f"{HUB}://").split("/")
        return f"{owner}/{name}", "".join(f"{part}/" for part in folder)

    def _failed(self, error: Exception) -> UserError:
        lines = str(error).strip().splitlines() or [""]
        return UserError(
            f"{self.specification.source} cannot be had from the hub: {type(error).__name__}: {lines[0]:.200}",
            hint="run the same command again: it goes on where it stopped; a private repository needs `hf auth login`",
            code=ExitCode.NOT_RUN,
        )


def _hub_client(name: str) -> Any:
    try:
        import huggingface_hub
    except ImportError as error:
        raise UserError(
            f"checkpoint {name!r} is on the Hugging Face hub, whose client cannot be imported here: {error}",
            hint=f"{how_to_install('hub')}, or give a folder that has it with --mirror",
            code=ExitCode.NOT_RUN,
        ) from None
    return huggingface_hub


def _completed(file: File, entry: Any) -> File:
    """Return a file with what the hub knows of it where the specification does not say it."""
    large = entry.lfs.sha256 if getattr(entry, "lfs", None) else None
    return File(check_path(file.path, "the hub"), file.sha256 or large, entry.size if file.size is None else file.size)


def _is_hidden(path: str) -> bool:
    return any(part.startswith(".") for part in path.split("/"))


def _in_mirror(specification: Specification, mirror: Path) -> Path:
    names = [name for name in (specification.digest, specification.name) if name]
    for name in names:
        if (mirror / name).exists():
            inner = None if specification.file_name is None else mirror / name / specification.file_name
            return inner if inner is not None and inner.is_file() else mirror / name
    looked = " or ".join(str(mirror / name) for name in names)
    raise NotFoundError(f"the mirror does not have checkpoint {specification.name!r}: there is no {looked}")
