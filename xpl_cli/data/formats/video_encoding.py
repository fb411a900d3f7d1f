"""Writing, copying and joining of videos: one for each episode and camera, every frame at its step's time."""

from __future__ import annotations

import fractions
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.data.formats import libraries, video
from xpl_cli.data.formats.writing import VIDEO
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_GROUP: Final = "2"
"""Frames per group of pictures, as LeRobot has it: seeking to a single frame is fast."""
_FINEST: Final = 1_000_000


def encode_video(path: Path, frames: Iterable[NDArray[np.uint8]], rate_hz: float, codec: str, crf: int) -> int:
    """Write a video of RGB frames (H, W, 3) uint8; return the number of frames.

    Raises:
        DataError: the encoder rejects frames of this size, or is missing.
    """
    av = libraries.av()
    name = VIDEO[codec]
    options = {"crf": str(crf), "g": _GROUP}
    # Episodes are encoded in several processes: an encoder with threads of its own would only wait for the others.
    options |= {"preset": "12", "svtav1-params": "lp=1"} if codec == "av1" else {"bf": "0", "threads": "1"}
    count, stream = 0, None
    try:
        with _quiet(), av.open(str(path), "w", format="mp4") as output:
            for frame in frames:
                if stream is None:
                    stream = output.add_stream(name, _rate(rate_hz), options=options)
                    stream.height, stream.width, stream.pix_fmt = *frame.shape[:2], "yuv420p"
                output.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
                count += 1
            if stream is not None:
                output.mux(stream.encode(None))
    except (av.error.FFmpegError, ValueError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(
            f"{path.name} cannot be written as {codec}: {error}",
            hint="--images png takes images of any size, --codec selects another encoder",
        ) from None
    return count


def copy_video(source: Path, begins_s: float, rate_hz: float, length: int, path: Path) -> bool:
    """Copy an episode's part of a video without re-encoding; return False where frames and packets do not match."""
    av = libraries.av()
    with _quiet(), video.opened(source) as (container, stream), av.open(str(path), "w", format="mp4") as output:
        target = output.add_stream_from_template(stream, opaque=True)
        target.time_base = stream.time_base
        container.seek(max(0, int(begins_s / stream.time_base)), stream=stream)
        due, tick_s = 0, float(stream.time_base)  # fractions cost most of a copy
        for packet in container.demux(stream):
            if packet.dts is None or packet.pts is None:
                continue
            frame_index = round((packet.pts * tick_s - begins_s) * rate_hz)
            if frame_index < 0:
                continue
            if frame_index >= length:
                break
            if frame_index != due or (due == 0 and not packet.is_keyframe):
                return False
            packet.pts = packet.dts = round(due / (rate_hz * tick_s))
            packet.stream = target
            output.mux(packet)
            due += 1
    return due == length


def join_videos(path: Path, parts: Iterable[tuple[Path, int]], rate_hz: float) -> None:
    """Concatenate videos written by the functions above, each given with its number of frames."""
    av = libraries.av()
    target, frames = None, 0
    with _quiet(), av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as output:
        for part, count in parts:
            with video.opened(part) as (container, stream):
                if target is None:
                    target = output.add_stream_from_template(stream, opaque=True)
                    target.time_base = stream.time_base
                ticks = 1 / (rate_hz * float(stream.time_base))
                for frame_index, packet in enumerate(_packets(container, stream)):
                    packet.pts = packet.dts = round((frames + frame_index) * ticks)
                    packet.stream = target
                    output.mux(packet)
            frames += count


def _packets(container: Any, stream: Any) -> Iterator[Any]:
    return (packet for packet in container.demux(stream) if packet.dts is not None)


def _rate(rate_hz: float) -> fractions.Fraction:
    return fractions.Fraction(rate_hz).limit_denominator(_FINEST)


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the log messages of the video libraries."""
    av = libraries.av()
    os.environ.setdefault("SVT_LOG", "1")  # the encoder logs its settings past the library: errors only
    before = av.logging.get_level()
    av.logging.set_level(av.logging.ERROR)
    try:
        yield
    finally:
        av.logging.set_level(before)
