"""The user's cache folder, for data that the tool can create or fetch again."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from xpl_cli.basics.errors import ExitCode, UserError

VARIABLE: Final = "XPL_CACHE"


def folder() -> Path:
    """Return `$XPL_CACHE`, or `xpl` in the user's cache: `$XDG_CACHE_HOME`, by default `~/.cache`.

    A relative path in either variable is ignored: it would depend on the working directory.

    Raises:
        UserError: if the user has no home folder.
    """
    configured, base = (Path(os.environ.get(name, "")) for name in (VARIABLE, "XDG_CACHE_HOME"))
    if configured.is_absolute():
        return configured
    try:
        return (base if base.is_absolute() else Path.home() / ".cache") / "xpl"
    except RuntimeError:
        raise UserError(
            "there is no home folder for a cache",
            hint=f"choose one: {VARIABLE}=/path/of/a/folder",
            code=ExitCode.NOT_RUN,
        ) from None
