"""Recognises whose files a folder holds, and reads them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl_cli.adopt.checkpoints.lerobot import checkpoint as lerobot
from xpl_cli.adopt.checkpoints.lerobot import dataset
from xpl_cli.adopt.checkpoints.reading import Folder
from xpl_cli.basics.errors import NotFoundError, UserError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from xpl_cli.adopt.checkpoints.trained import Trained

MAKERS = ("LeRobot",)


def read(paths: Sequence[Path]) -> tuple[Trained, Folder]:
    """Return what was trained, and the folder of the checkpoint.

    Args:
        paths: the folder of one checkpoint, and of the data set that it was trained on if the user has that too.

    Raises:
        NotFoundError: if there is no such folder.
        UserError: if it is nobody's that is known, or several checkpoints, or a file in it is not what it should be.
    """
    data, found = None, []
    for path in paths:
        folder = _folder(path)
        if dataset.recognises(folder):
            data = dataset.read(folder)
        elif (place := lerobot.inner(folder)) is not None:
            found.append(place)
        else:
            raise UserError(
                f"{path} is no checkpoint that is known: expected the folder of one of {', '.join(MAKERS)}",
                hint="give the folder that holds config.json, or the run that it lies in",
            )
    if len(found) != 1:
        what = f"{len(found)} checkpoints" if found else "a data set and no checkpoint"
        raise UserError(f"--from was given {what}: expected one checkpoint, and its data set where you have it")
    return lerobot.read(found[0], data), found[0]


def _folder(path: Path) -> Folder:
    if not path.exists():
        raise NotFoundError(f"there is no {path}")
    if not path.is_dir():
        raise UserError(f"{path} is a file: expected the folder that training wrote")
    # A data set is told by its name, since the checkpoint's files go by their names alone.
    return Folder(path, path.resolve().name if dataset.recognises(Folder(path)) else "")
