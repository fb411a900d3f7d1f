"""An episode as a recording for the Rerun viewer; needs rerun-sdk."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.show.episode_view import MOST_CURVES

if TYPE_CHECKING:
    from xpl_cli.data.sets.interface import Demonstrations, RecordedEpisode

_STEP, _TIME = "step", "time"


def write(demonstrations: Demonstrations, episode: RecordedEpisode, path: Path) -> None:
    """Write an episode as an .rrd: cameras and columns under their names, by step and, if the rate is known, by time.

    Raises:
        DataError: rerun-sdk is not installed, or the episode cannot be read.
    """
    try:
        import rerun
    except ImportError as error:
        raise DataError(
            f"recordings for Rerun need rerun-sdk, which cannot be imported: {error}", hint="pip install rerun-sdk"
        ) from None
    recording = rerun.RecordingStream("xpl", recording_id=f"{demonstrations.path}:{episode.key}")
    recording.save(str(path))
    for sentence in episode.instructions:
        recording.log(sdk.Obs.INSTRUCTION, rerun.TextDocument(sentence), static=True)
    for name, column in episode.columns.items():
        rows = episode.read(name)
        if column.dtype == "str" or rows[:1].size > MOST_CURVES:
            continue
        for index, row in enumerate(rows.reshape(len(rows), -1)):
            _at(recording, index, demonstrations.rate_hz)
            recording.log(name, rerun.Scalars(row.astype(float)))
    for name, camera in episode.cameras.items():
        for index, image in enumerate(episode.frames(name)):
            _at(recording, index, demonstrations.rate_hz)
            entity = rerun.DepthImage(image) if camera.kind == sdk.Camera.DEPTH else rerun.Image(image).compress()
            recording.log(name, entity)
    recording.flush()


def _at(recording: object, index: int, rate_hz: float | None) -> None:
    recording.set_time(_STEP, sequence=index)  # type: ignore[attr-defined]
    if rate_hz:
        recording.set_time(_TIME, duration=index / rate_hz)  # type: ignore[attr-defined]
