"""All tasks of an environment in one picture."""

from __future__ import annotations

import io
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl_cli.basics import atomic
from xpl_cli.environments import film, rollout
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from xpl_cli.environments.rollout import Scenario

_COLUMNS, _LINE = 4, 18  # pictures side by side; pixels of a line of text
_MANY, _SIDE_BY_SIDE, _WIDTH = 16, 8, 112  # more tasks than so many: how many pictures, how wide
_ENDINGS = (".png", ".jpg")
_PAPER, _INK = (255, 255, 255), (30, 30, 30)


def sheet(scenario: Scenario, seed: int, camera: str | None, out: Path, chosen: Sequence[str] = ()) -> dict[str, Any]:
    """Save an image of the first frame of every task, with the tasks' names; return its description.

    Args:
        scenario: scenario; its task is ignored, and tasks that do not support its embodiment are left out.
        seed: of all episodes.
        camera: name; the overview camera by default.
        out: file, which must end in .png or .jpg.
        chosen: tasks or splits; all by default.

    Raises:
        NotFoundError: there is no such camera.
        UserError: the renderer is missing, or another ending.
    """
    from PIL import Image, ImageDraw

    film.check_ending(out, _ENDINGS)
    camera = film.camera_of(scenario, camera)
    facts = environments.manifest(environments.find(scenario.environment))
    entries = facts.tasks
    names = [rollout.choose_name("task", task, entries) for task in rollout.expand_splits(facts, chosen)] or list(
        entries
    )
    tasks = [task for task in names if rollout.unsupported(entries[task], scenario.embodiment) is None]
    frames = [picture for picture, _ in film.first_frames(scenario, tasks, seed, camera)]
    columns = min(_COLUMNS, len(frames))
    if len(frames) > _MANY:
        frames, columns = [_smaller(picture) for picture in frames], _SIDE_BY_SIDE
    height, width = frames[0].shape[0] + _LINE, frames[0].shape[1]
    paper = Image.new("RGB", (columns * width, math.ceil(len(frames) / columns) * height), _PAPER)
    pen = ImageDraw.Draw(paper)
    for index, (task, picture) in enumerate(zip(tasks, frames, strict=True)):
        row, column = divmod(index, columns)
        paper.paste(Image.fromarray(picture), (column * width, row * height + _LINE))
        pen.text((column * width + width // 2, row * height + _LINE // 2), task, _INK, anchor="mm")
    buffer = io.BytesIO()
    paper.save(buffer, Image.registered_extensions()[out.suffix.lower()], optimize=True)
    atomic.write_file(out, buffer.getvalue())
    measures = {"height": paper.height, "width": paper.width}
    return {**film.describe_picture(scenario, seed, camera, out), **measures, "task": tasks}


def _smaller(picture: np.ndarray) -> np.ndarray:
    """Return a picture (H, W, 3) of a width at which many fit on a page."""
    from PIL import Image

    height = max(1, round(picture.shape[0] * _WIDTH / picture.shape[1]))
    return np.asarray(Image.fromarray(picture).resize((_WIDTH, height), Image.Resampling.BOX))
