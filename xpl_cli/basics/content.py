"""Folders of content, and loading of packages inside them.

The engine (`xpl`, `xpl_cli`) is installed; everything a contributor adds (spec, templates, rules, environments,
policies, skills) is content: found by path and loaded under a module name of its own, so that no generic import name
(`envs`, `policy`) ever shadows a package of a simulator or of a model.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from xpl import registry
from xpl.process.modules import load_module

__all__ = ["content_folder", "is_installed", "load_module", "package_argument"]

_INSTALLED = Path(__file__).parents[1] / "_content"
_CHECKOUT = Path(__file__).parents[2]
_HIDDEN = {"skills": ".agents/skills"}
"""Folders that a checkout keeps in a conventional place."""


@cache
def content_folder(name: str) -> Path:
    """Return the content folder `name` (``"spec"``, ``"envs"``, ...): of the checkout or of the wheel."""
    shipped = _INSTALLED / name
    return shipped if shipped.is_dir() else _CHECKOUT / _HIDDEN.get(name, name)


def is_installed(folder: Path) -> bool:
    """Tell whether a package belongs to an installed distribution, whose folder is read-only."""
    folders = (_INSTALLED.resolve(), *(path.resolve() for path in registry.folders(registry.ENVS)))
    return any(folder.resolve().is_relative_to(path) for path in folders)


def package_argument(folder: Path) -> str:
    """Return the command line argument for a package: the name of an installed one, the path of any other."""
    return folder.name if is_installed(folder) else str(folder)
