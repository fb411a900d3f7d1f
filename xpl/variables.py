"""Environment variables that policy.yml declares for the processes that load its model."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import checkpoint, user_cache

if TYPE_CHECKING:
    from xpl.contract import Config

_CHECKPOINT = "{checkpoint}"
"""In a value: the folder of the checkpoint."""
_CACHE = "{cache}"
"""In a value: a folder in the cache of xpl, for what libraries compile on this kind of processor."""
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Of tiny weights, whose work is too small to share: several threads wait for each other longer than they compute."""


def set_declared(policy_dir: str | Path, config: Config, environment: object, *, is_made: bool = True) -> None:
    """Set the variables before anything imports the authors' code.

    A value with `{checkpoint}` names a file or folder of the checkpoint; where there is none, nothing is set. One with
    `{cache}` names a file or folder in the cache of xpl; a user without a home folder has none.

    Args:
        policy_dir: folder of the adapter.
        config: its configuration, which names the checkpoint.
        environment: `environment` of policy.yml.
        is_made: whether the checkpoint is there; if not, it becomes a tiny one, and such a variable is set as well.
    """
    folders = checkpoint.folders(config, policy_dir)[1:]
    if not is_made or any((folder / checkpoint.TINY).is_file() for folder in folders):
        for name in _THREADS:
            os.environ.setdefault(name, "1")
    declared = environment.get("variables") if isinstance(environment, Mapping) else None
    for name, template in (declared or {}).items():
        value = str(template)
        if _CACHE in value:
            try:
                value = value.replace(_CACHE, str(compiled_folder()))
            except RuntimeError:
                continue
        if _CHECKPOINT not in value:
            os.environ[name] = value
            continue
        for folder in folders:
            path = value.replace(_CHECKPOINT, str(folder))
            if not is_made or os.path.exists(path):  # noqa: PTH110 - a value need not be a path
                os.environ[name] = path


def compiled_folder() -> Path:
    """Return the folder for what libraries compile, one for each kind of processor: several machines may share a home.

    Raises:
        RuntimeError: if the user has no home folder.
    """
    kind = platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    features = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    digest = hashlib.sha256(" ".join(sorted(features.split())).encode()).hexdigest()[:8]
    return user_cache.folder() / "compiled" / f"{kind}-{digest}"
