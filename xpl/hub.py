"""Local copies of the hub repositories that loading a model names, such as a VLM's tokenizer.

Files of a checkpoint, and its authors' code, name repositories of the Hugging Face hub. Their copies lie in a cache of
the hub's own form (https://huggingface.co/docs/huggingface_hub/guides/manage-cache), in the checkpoint or in the
package, and the hub's client reads this cache instead of asking the hub. So no name has to be changed in a file or in
code.
"""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import _spec as spec
from xpl import checkpoint

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl.contract import Config

FOLDER = "hub"
"""Cache of hub repositories, in a checkpoint or in the package's folder of checkpoints."""
_BRANCH = "main"
"""What the hub's client asks for if the code names no revision."""
_SEPARATOR = "--"
_LONGEST_COMMIT = 40


def offer(policy_dir: str | Path, config: Config) -> None:
    """Let this process read hub repositories from local copies, before anything imports the hub's client.

    Without copies, nothing changes: the hub's client uses the user's own cache and network.

    Args:
        policy_dir: folder of the adapter.
        config: its configuration, which names the checkpoint.
    """
    for folder in _caches(Path(policy_dir), config):
        if folder.is_dir():
            use(folder)
            return


def use(folder: Path) -> None:
    """Make a folder the cache of the hub's client in this process, without a network."""
    os.environ["HF_HUB_CACHE"] = str(folder)
    os.environ["HF_HUB_OFFLINE"] = "1"


def add(folder: Path, name: str, revision: str, source: Path) -> None:
    """Add a repository to a cache as a link, so that its name without a revision means this revision.

    Args:
        folder: the cache.
        name: `owner/repository`.
        revision: full commit.
        source: folder with the repository's files.
    """
    _name_revision(folder, name, revision)
    link = folder / _entry(name) / "snapshots" / revision
    link.parent.mkdir(parents=True, exist_ok=True)
    link.unlink(missing_ok=True)
    link.symlink_to(source, target_is_directory=True)


def pack(folder: Path) -> None:
    """Turn `owner--repository` folders, as tiny.py writes them, into a cache; their digest is the revision."""
    for source in sorted(path for path in folder.glob(f"*{_SEPARATOR}*") if not path.name.startswith("models--")):
        name = source.name.replace(_SEPARATOR, "/", 1)
        revision = _digest(source)
        _name_revision(folder, name, revision)
        target = folder / _entry(name) / "snapshots" / revision
        target.parent.mkdir(parents=True, exist_ok=True)
        source.rename(target)


def _caches(policy_dir: Path, config: Config) -> Iterator[Path]:
    tiny = checkpoint.tiny_folder(config, policy_dir)  # a key may name a folder inside of it
    for folder in (*([tiny] if tiny is not None else []), *reversed(checkpoint.folders(config, policy_dir)[1:])):
        yield folder / FOLDER
    yield policy_dir / spec.CHECKPOINT_DIRECTORY / FOLDER


def _entry(name: str) -> str:
    if not re.fullmatch(r"[\w.-]+(/[\w.-]+)?", name, re.ASCII):
        raise ValueError(f"expected a hub repository as owner/name, got {name!r}")
    return f"models{_SEPARATOR}{name.replace('/', _SEPARATOR)}"


def _name_revision(folder: Path, name: str, revision: str) -> None:
    path = folder / _entry(name) / "refs" / _BRANCH
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(revision, encoding="ascii")  # without a line end, as the client writes it


def _digest(folder: Path) -> str:
    digest = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        digest.update(path.relative_to(folder).as_posix().encode() + b"\0")
        digest.update(path.read_bytes())
    return digest.hexdigest()[:_LONGEST_COMMIT]
