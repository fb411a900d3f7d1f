"""The user's cache folder, for data that the tool can create or fetch again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl import user_cache
from xpl_cli.basics.errors import ExitCode, UserError

if TYPE_CHECKING:
    from pathlib import Path


def folder() -> Path:
    """Return the folder of `xpl.user_cache`.

    Raises:
        UserError: if the user has no home folder.
    """
    try:
        return user_cache.folder()
    except RuntimeError:
        raise UserError(
            "there is no home folder for a cache",
            hint=f"choose one: {user_cache.VARIABLE}=/path/of/a/folder",
            code=ExitCode.NOT_RUN,
        ) from None
