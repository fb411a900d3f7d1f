"""Reading of video frames by time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl.image_codec import PIXELS
from xpl_cli.data.formats import libraries
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_MOST_BETWEEN: Final = 10_000
"""Most frames that are decoded to reach one; encoders write a key frame at least every 250 frames."""
_CODECS: Final = {"libdav1d": "av1", "libsvtav1": "av1", "libaom-av1": "av1", "libx264": "h264"}


def described(path: Path) -> tuple[int, int, str]:
    """Return height, width and codec of a video.

    Raises:
        DataError: the file is no video, or its frames are too large.
    """
    with opened(path) as (_, stream):
        name = stream.codec_context.name
        return stream.height, stream.width, _CODECS.get(name, name)


def frames(path: Path, begins_s: float, rate_hz: float, start: int, stop: int) -> Iterator[NDArray[np.uint8]]:
    """Yield frames `start` to `stop` of an episode, (H, W, 3) uint8.

    Args:
        path: the video, which may hold other episodes too.
        begins_s: when the episode begins in it.
        rate_hz: steps per second.
        start: first frame, counted from the episode's first.
        stop: the frame after the last.

    Raises:
        DataError: a frame is missing, or cannot be decoded.
    """
    if start >= stop:
        return
    with opened(path) as (container, stream):
        due = start
        try:
            container.seek(max(0, int((begins_s + start / rate_hz) / stream.time_base) - 1), stream=stream)
            for count, frame in enumerate(container.decode(stream)):
                if count > _MOST_BETWEEN and due == start:
                    raise DataError(f"{path} has no key frame in {_MOST_BETWEEN} frames before frame {start}")
                frame_index = round((frame.time - begins_s) * rate_hz)
                if frame_index < due:
                    continue
                if frame_index > due:
                    break
                yield frame.to_ndarray(format="rgb24")
                due += 1
                if due == stop:
                    return
        except libraries.av().error.FFmpegError as error:
            raise DataError(f"{path}: frame {due} cannot be decoded: {error.strerror}") from None
    raise DataError(
        f"{path} has no frame {due} of the episode at {begins_s:g} s, at {rate_hz:g} Hz; expected are {stop}",
        hint="the video is shorter than the episode, or frames were lost",
    )


@contextmanager
def opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a video with the MP4 demuxer only: other demuxers would follow references to further files."""
    av = libraries.av()
    try:
        container = av.open(str(path), format="mp4", metadata_errors="replace")
    except FileNotFoundError:
        raise DataError(f"there is no video {path}") from None
    except (av.error.FFmpegError, OSError) as error:
        raise DataError(f"{path} cannot be read as an MP4 video: {error.strerror}") from None
    with container:
        if not container.streams.video:
            raise DataError(f"{path} holds no video")
        stream = container.streams.video[0]
        if stream.height * stream.width > PIXELS:
            raise DataError(f"{path} has frames of {stream.height} x {stream.width} pixels, more than {PIXELS} in all")
        stream.thread_type = "AUTO"
        yield container, stream
