"""Where the content rooms are, and how a package inside them is loaded.

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
"""Rooms that a checkout keeps where others look for them."""


@cache
def content_folder(name: str) -> Path:
    """Return the folder of the content room `name` (``"spec"``, ``"envs"``, ...): a checkout's own, or the wheel's."""
    shipped = _INSTALLED / name
    return shipped if shipped.is_dir() else _CHECKOUT / _HIDDEN.get(name, name)


def is_installed(folder: Path) -> bool:
    """Tell whether a package came with the installed tool or another one, where nothing should be written beside it."""
    places = (_INSTALLED.resolve(), *(place.resolve() for place in registry.folders(registry.ENVS)))
    return any(folder.resolve().is_relative_to(place) for place in places)


def package_argument(folder: Path) -> str:
    """Return what a command takes for a package: the name of one that was installed, the path of any other."""
    return folder.name if is_installed(folder) else str(folder)
