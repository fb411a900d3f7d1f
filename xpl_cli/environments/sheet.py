"""All tasks of an environment in one picture."""

from __future__ import annotations

import io
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from xpl_cli.basics import atomic
from xpl_cli.environments import film, play
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.environments.play import Scenario

_COLUMNS, _LINE = 4, 18  # pictures side by side; pixels of a line of text
_PAPER, _INK = (255, 255, 255), (30, 30, 30)


def sheet(what: Scenario, seed: int, camera: str | None, out: Path) -> dict[str, Any]:
    """Write a picture of how an episode of every task begins, with the tasks' names; return what it shows.

    Args:
        what: whatever its task; tasks that are not offered with its embodiment are left out.
        seed: of all episodes.
        camera: from where; the camera for people by default.
        out: file, which must end in .png.

    Raises:
        NotFoundError: there is no such camera.
        UserError: the renderer is missing, or another ending.
    """
    from PIL import Image, ImageDraw

    film.check_ending(out, (".png",))
    camera = film.camera_of(what, camera)
    entries = environments.manifest(environments.find(what.environment))["tasks"]
    tasks = [task for task, entry in entries.items() if play.unsupported(entry, what.embodiment) is None]
    seen = [film.first_look(replace(what, task=task), seed, camera)[0] for task in tasks]
    height, width = seen[0].shape[0] + _LINE, seen[0].shape[1]
    columns = min(_COLUMNS, len(seen))
    paper = Image.new("RGB", (columns * width, math.ceil(len(seen) / columns) * height), _PAPER)
    pen = ImageDraw.Draw(paper)
    for place, (task, picture) in enumerate(zip(tasks, seen, strict=True)):
        row, column = divmod(place, columns)
        paper.paste(Image.fromarray(picture), (column * width, row * height + _LINE))
        pen.text((column * width + width // 2, row * height + _LINE // 2), task, _INK, anchor="mm")
    buffer = io.BytesIO()
    paper.save(buffer, "png", optimize=True)
    atomic.write_file(out, buffer.getvalue())
    size = {"height": paper.height, "width": paper.width}
    return {**film.shown(what, seed, camera, out), **size, "task": tasks}
