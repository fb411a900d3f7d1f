"""The user's cache folder, for data that can be made or fetched again."""

from __future__ import annotations

import os
from pathlib import Path

VARIABLE = "XPL_CACHE"


def folder() -> Path:
    """Return `$XPL_CACHE`, or `xpl` in the user's cache: `$XDG_CACHE_HOME`, by default `~/.cache`.

    A relative path in either variable is ignored: it would depend on the working directory.

    Raises:
        RuntimeError: if the user has no home folder.
    """
    configured, base = (Path(os.environ.get(name, "")) for name in (VARIABLE, "XDG_CACHE_HOME"))
    if configured.is_absolute():
        return configured
    return (base if base.is_absolute() else Path.home() / ".cache") / "xpl"
