"""Whether a missing module belongs to the adapter, or to a third party and needs to be installed."""

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
_NEEDS = (".txt", ".toml", ".cfg", ".yml", ".yaml", ".sh")  # files that list requirements
_SETUP = "setup.py"
_PROJECT = ("pyproject.toml", _SETUP, "setup.cfg", "requirements.txt", ".git")  # mark a folder as a repository
_DEPTH = 4
_MOST = 400  # files that list requirements, of one adapter
_LARGEST = 1 << 20
# Distributions whose name differs from their module's.
_DISTRIBUTION_NAMES = {
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
    """Return whether a missing module belongs to a third party.

    A name equal or similar to a file or folder of the adapter is the adapter's own: a misspelt import is a mistake,
    unless its requirements or a vendored repository name the module. A missing part of an installed package is a
    mistake, too.
    """
    top = module.partition(".")[0]
    own = own_names(policy_dir)
    if not top or top in own or top.startswith("_xpl_policy_") or _is_importable(top):
        return False
    if not difflib.get_close_matches(top, own, n=1, cutoff=_ENOUGH_ALIKE):
        return True
    return _is_installed_by(top, policy_dir) or _is_imported_by_vendored(top, policy_dir)


def own_names(policy_dir: Path) -> frozenset[str]:
    """Return the names of an adapter's modules and packages, without vendored repositories."""
    names: set[str] = set()
    for folder, folders, files in os.walk(policy_dir):
        is_top = Path(folder) == policy_dir
        if not is_top and any(mark in files or mark in folders for mark in _PROJECT):
            folders[:] = []
            continue
        folders[:] = [name for name in folders if name.isidentifier() and name != spec.CHECKPOINT_DIRECTORY]
        names.update(name[: -len(".py")] for name in files if name.endswith(".py"))
        if not is_top and any(name.endswith(".py") for name in files):
            names.add(Path(folder).name)
    return frozenset(names)


def vendored_repositories(policy_dir: Path) -> list[Path]:
    """Return the outermost folders of vendored repositories in an adapter."""
    repositories: list[Path] = []
    for folder, folders, files in os.walk(policy_dir):
        place = Path(folder)
        if place != policy_dir and any(mark in files or mark in folders for mark in _PROJECT):
            repositories.append(place)
            folders[:] = []
        elif len(place.relative_to(policy_dir).parts) >= _DEPTH:
            folders[:] = []
    return sorted(repositories)


def _is_installed_by(module: str, policy_dir: Path) -> bool:
    """Return whether the adapter's requirements name a module or its distribution."""
    names = {module, _DISTRIBUTION_NAMES.get(module, module)}
    words = "|".join(re.escape(name).replace("_", "[-_]") for name in sorted(names))
    pattern = re.compile(rf"(?<![\w.-])(?:{words})(?![\w-])", re.IGNORECASE)
    return any(pattern.search(text) for text in _requirement_texts(policy_dir))


def _requirement_texts(policy_dir: Path) -> Iterator[str]:
    """Yield the texts of requirement files, also of vendored repositories."""
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
    files = (path for root in vendored_repositories(policy_dir) for path in itertools.islice(root.rglob("*.py"), _MOST))
    small = (path for path in files if path.is_file() and path.stat().st_size <= _LARGEST)
    return any(pattern.search(path.read_text(encoding="utf-8", errors="replace")) for path in small)


def _is_importable(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):
        return False
