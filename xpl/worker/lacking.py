"""What a machine lacks when an adapter cannot be loaded on it, told from what is wrong with the adapter."""

from __future__ import annotations

import difflib
import importlib.util
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from xpl import _spec as spec
from xpl.checkpoint import CheckpointError

_OPEN_LIBRARY = "cannot open shared object file"  # the dynamic linker's words
_ENOUGH_ALIKE = 0.8
_NEEDS = (".txt", ".toml", ".cfg", ".yml", ".yaml", ".sh")  # files that say what to install


class StandInError(RuntimeError):
    """What stands in for a model, or for a module, was asked for something that only the real one can give.

    Attributes:
        kind: which stand-in; a kind of what `lacking` returns.
    """

    kind = "model"


def lacking(error: BaseException, policy_dir: Path, config: Mapping[str, Any]) -> dict[str, str] | None:
    """Return what the failure of a load says that this machine lacks, or None if the adapter itself is at fault.

    Args:
        error: what loading raised; what it was raised from counts, too.
        policy_dir: folder of the adapter.
        config: its configuration, which names the checkpoint.

    Returns:
        a map of `kind` and `name`: a third-party `module`, a shared `library`, the `checkpoint`, a `device`; what a
        `shadow` or a `stub` cannot give in place of the real one; or that the adapter is a `whole` without a shadow.
    """
    for cause in _causes(error):
        found = _lacking(cause, policy_dir, config)
        if found is not None:
            return {"kind": found[0], "name": found[1]}
    return None


def is_third_party(module: str, policy_dir: Path) -> bool:
    """Tell whether a module that cannot be found belongs to somebody else.

    A name that a file or folder of the adapter has, or nearly has, is the adapter's: a misspelt import is a mistake,
    unless what it installs is called so. A missing part of a package that is there is a mistake, too.
    """
    top = module.partition(".")[0]
    own = own_names(policy_dir)
    if not top or top in own or top.startswith("_xpl_policy_") or _is_there(top):
        return False
    return _is_installed_by(top, policy_dir) or not difflib.get_close_matches(top, own, n=1, cutoff=_ENOUGH_ALIKE)


def own_names(policy_dir: Path) -> frozenset[str]:
    """Return the names that the modules and packages of an adapter have."""
    found: set[str] = set()
    for folder, folders, files in os.walk(policy_dir):
        folders[:] = [name for name in folders if name.isidentifier() and name != spec.CHECKPOINT_DIRECTORY]
        found.update(name[: -len(".py")] for name in files if name.endswith(".py"))
        if Path(folder) != policy_dir and any(name.endswith(".py") for name in files):
            found.add(Path(folder).name)
    return frozenset(found)


def _lacking(error: BaseException, policy_dir: Path, config: Mapping[str, Any]) -> tuple[str, str] | None:
    found: tuple[str, str] | None = None
    if isinstance(error, StandInError):
        found = error.kind, str(error)
    elif isinstance(error, ModuleNotFoundError):
        found = ("module", error.name) if error.name and is_third_party(error.name, policy_dir) else None
    elif isinstance(error, (ImportError, OSError)) and _OPEN_LIBRARY in str(error):
        found = "library", str(error).partition(":")[0]
    elif isinstance(error, CheckpointError):
        found = "checkpoint", str(error)
    elif isinstance(error, FileNotFoundError) and isinstance(error.filename, (str, os.PathLike)):
        path = policy_dir / os.fspath(error.filename)
        found = ("checkpoint", f"there is no {path}") if _in_checkpoint(path, policy_dir, config) else None
    elif isinstance(error, (RuntimeError, AssertionError)) and "cuda" in str(error).lower() and not _has_gpu():
        found = "device", "a CUDA device"
    return found


def _causes(error: BaseException) -> Iterator[BaseException]:
    """Yield an exception and what it was explicitly raised from, each once: they may go round in a circle."""
    cause: BaseException | None = error
    seen: set[int] = set()
    while cause is not None and id(cause) not in seen:
        yield cause
        seen.add(id(cause))
        cause = cause.__cause__


def _is_installed_by(module: str, policy_dir: Path) -> bool:
    """Tell whether the files that say what an adapter needs name a module, or the distribution that is called so."""
    name = re.compile(rf"(?<![\w.-]){re.escape(module).replace('_', '[-_]')}(?![\w-])", re.IGNORECASE)
    files = [path for path in policy_dir.iterdir() if path.suffix in _NEEDS and path.is_file()]
    return any(name.search(path.read_text(encoding="utf-8", errors="replace")) for path in files)


def _in_checkpoint(path: Path, policy_dir: Path, config: Mapping[str, Any]) -> bool:
    named = [config.get(key) for key in (*spec.CHECKPOINT_KEYS, spec.Deploy.CKPT_NAME)]
    roots = [spec.CHECKPOINT_DIRECTORY, *(name for name in named if isinstance(name, str) and name)]
    return any(root == path or root in path.parents for root in (policy_dir / name for name in roots))


def _is_there(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):
        return False


def _has_gpu() -> bool:
    return any(Path("/dev").glob("nvidia[0-9]*"))
