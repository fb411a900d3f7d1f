"""Whose a module is that cannot be found: the adapter's own, or somebody else's that would have to be installed."""

from __future__ import annotations

import difflib
import importlib.util
import itertools
import os
import re
from collections.abc import Iterator
from pathlib import Path

from xpl import _spec as spec

_ENOUGH_ALIKE = 0.8
_NEEDS = (".txt", ".toml", ".cfg", ".yml", ".yaml", ".sh")  # files that say what to install
_SETUP = "setup.py"
_PROJECT = ("pyproject.toml", _SETUP, "setup.cfg", "requirements.txt", ".git")  # make a folder somebody's repository
_DEPTH = 4
_MOST = 400  # files that say what to install, of one adapter
_LARGEST = 1 << 20
# Distributions that are called otherwise than what they let one import, as those who package them do.
_CALLED = {
    "cv2": "opencv",
    "PIL": "pillow",
    "yaml": "pyyaml",
    "sklearn": "scikit-learn",
    "skimage": "scikit-image",
    "hydra": "hydra-core",
    "Levenshtein": "levenshtein",
    "attr": "attrs",
    "google": "protobuf",
    "tensorflow_hub": "tensorflow",
    "msgpack_numpy": "msgpack-numpy",
}


def is_third_party(module: str, policy_dir: Path) -> bool:
    """Tell whether a module that cannot be found belongs to somebody else.

    A name that a file or folder of the adapter has, or nearly has, is the adapter's: a misspelt import is a mistake,
    unless what it installs is called so, or what it vendors imports it, too. A missing part of a package that is there
    is a mistake, too.
    """
    top = module.partition(".")[0]
    own = own_names(policy_dir)
    if not top or top in own or top.startswith("_xpl_policy_") or _is_there(top):
        return False
    if not difflib.get_close_matches(top, own, n=1, cutoff=_ENOUGH_ALIKE):
        return True
    return _is_installed_by(top, policy_dir) or _is_imported_by_vendored(top, policy_dir)


def own_names(policy_dir: Path) -> frozenset[str]:
    """Return the names that the modules and packages of an adapter have, without those of repositories it vendors."""
    found: set[str] = set()
    for folder, folders, files in os.walk(policy_dir):
        is_top = Path(folder) == policy_dir
        if not is_top and any(mark in files or mark in folders for mark in _PROJECT):
            folders[:] = []
            continue
        folders[:] = [name for name in folders if name.isidentifier() and name != spec.CHECKPOINT_DIRECTORY]
        found.update(name[: -len(".py")] for name in files if name.endswith(".py"))
        if not is_top and any(name.endswith(".py") for name in files):
            found.add(Path(folder).name)
    return frozenset(found)


def vendored(policy_dir: Path) -> list[Path]:
    """Return the folders of an adapter that are somebody's repository, the outermost ones."""
    found: list[Path] = []
    for folder, folders, files in os.walk(policy_dir):
        place = Path(folder)
        if place != policy_dir and any(mark in files or mark in folders for mark in _PROJECT):
            found.append(place)
            folders[:] = []
        elif len(place.relative_to(policy_dir).parts) >= _DEPTH:
            folders[:] = []
    return sorted(found)


def _is_installed_by(module: str, policy_dir: Path) -> bool:
    """Tell whether the files that say what an adapter needs name a module, or the distribution that is called so."""
    names = {module, _CALLED.get(module, module)}
    words = "|".join(re.escape(name).replace("_", "[-_]") for name in sorted(names))
    pattern = re.compile(rf"(?<![\w.-])(?:{words})(?![\w-])", re.IGNORECASE)
    return any(pattern.search(text) for text in _needs(policy_dir))


def _needs(policy_dir: Path) -> Iterator[str]:
    """Yield the texts of the files that say what to install, also of what is vendored."""
    count = 0
    for folder, folders, files in os.walk(policy_dir):
        depth = len(Path(folder).relative_to(policy_dir).parts)
        folders[:] = [] if depth >= _DEPTH else sorted(name for name in folders if not name.startswith("."))
        for name in sorted(files):
            is_need = (
                name == _SETUP or "require" in name or (name.endswith(_NEEDS) and (depth == 0 or name in _PROJECT))
            )
            path = Path(folder, name)
            if is_need and count < _MOST and path.is_file() and path.stat().st_size <= _LARGEST:
                count += 1
                yield path.read_text(encoding="utf-8", errors="replace")


def _is_imported_by_vendored(module: str, policy_dir: Path) -> bool:
    pattern = re.compile(rf"^\s*(?:import|from)\s+{re.escape(module)}\b", re.MULTILINE)
    files = (path for root in vendored(policy_dir) for path in itertools.islice(root.rglob("*.py"), _MOST))
    small = (path for path in files if path.is_file() and path.stat().st_size <= _LARGEST)
    return any(pattern.search(path.read_text(encoding="utf-8", errors="replace")) for path in small)


def _is_there(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):
        return False
