"""What happened, on disk: a line for each control step, and the pictures, written beside the control loop."""

from __future__ import annotations

import json
import queue
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import image_codec

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from xpl.arms.driver import Numbers, Reading

_MOST_WAITING = 200


class Recorder:
    """Writes episodes below a folder: `NNN/steps.jsonl`, and `NNN/CAMERA/STEP.png`.

    Encoding takes time that a control loop does not have: a thread does it. What it cannot keep up with is left out,
    and counted (`dropped`).

    Args:
        folder: where episodes go; each gets the first number that is free.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._jobs: queue.Queue[tuple[Path, str | NDArray[np.uint8]] | None] = queue.Queue(_MOST_WAITING)
        self._thread: threading.Thread | None = None
        self._episode: Path | None = None
        self.dropped = 0

    def begin(self, about: Mapping[str, object]) -> None:
        """Begin an episode."""
        number = 1
        while True:
            place = self._folder / f"{number:03d}"
            try:
                place.mkdir(parents=True)
                break
            except FileExistsError:
                number += 1
        self._episode = place
        (place / "about.json").write_text(json.dumps(about, indent=2), encoding="utf-8")
        if self._thread is None:
            self._thread = threading.Thread(target=self._write, daemon=True)
            self._thread.start()

    def step(self, number: int, reading: Reading, command: Numbers) -> None:
        """Queue the record of one control step; do nothing outside an episode.

        Args:
            number: number of the step; it names the images.
            reading: measured state, rad and 0..1, time of the measurement in s, and camera images.
            command: command that followed, by key of the state, in the same units; rounded to six decimals.
        """
        if self._episode is None:
            return
        line = {"step": number, "at": reading.at, "state": _plain(reading.state), "command": _plain(command)}
        self._put(self._episode / "steps.jsonl", json.dumps(line) + "\n")
        for name, picture in reading.pictures.items():
            self._put(self._episode / name / f"{number:06d}.png", picture.image)

    def end(self, result: Mapping[str, object]) -> None:
        """Note how the episode ended."""
        if self._episode is not None:
            self._put(self._episode / "result.json", json.dumps({**result, "dropped": self.dropped}, indent=2))
        self._episode = None

    def close(self) -> None:
        """Write what is left."""
        if self._thread is not None:
            self._jobs.put(None)
            self._thread.join(timeout=10.0)
            self._thread = None

    def _put(self, path: Path, content: str | NDArray[np.uint8]) -> None:
        try:
            self._jobs.put_nowait((path, content))
        except queue.Full:
            self.dropped += 1

    def _write(self) -> None:
        while True:
            job = self._jobs.get()
            if job is None:
                return
            path, content = job
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                if isinstance(content, str):
                    with path.open("a", encoding="utf-8") as stream:
                        stream.write(content)
                else:
                    path.write_bytes(image_codec.encode_png(content))
            except OSError:
                self.dropped += 1


def _plain(values: Numbers) -> dict[str, list[float]]:
    return {key: value.round(6).tolist() for key, value in values.items()}
