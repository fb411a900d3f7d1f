"""Checks of images: as many as there are steps, none frozen, none mirrored or with blue and red exchanged."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from xpl_cli.audit.demonstrations.check import DatasetInfo, DemonstrationCheck, EpisodeData
from xpl_cli.audit.rules.model import Finding, NotApplicable
from xpl_cli.data.probe.sample import STATE, role_of, spread, words

if TYPE_CHECKING:
    from collections.abc import Iterator

_FROZEN: Final = 4
"""Images in a row that may be equal while the robot moves: a camera may be slower than the control rate."""
_SHARE: Final = 0.5
_FEWEST: Final = 3
"""Episodes without which none can be compared with others."""
_MOST_COMPARED: Final = 256
"""Episodes, evenly spread, whose first images make the usual one."""


class FrameCount(DemonstrationCheck):
    """Every step has its image.

    ## What it does
    Counts the images of each camera, decoded, and compares with the steps of the episode.

    ## Why it matters
    A video that is one image shorter than its states is read with an offset of one, or crashes a loader at
    the end.

    ## Example
    An episode of 200 steps with 199 images.

    ## Use instead
    Convert the episode again, or cut its states.

    ## Fix safety
    No automatic fix.
    """

    code, slug, severity, needs_images = "XPL709", "video-length", "must", True

    def inspect(self, episode: EpisodeData) -> None:
        """Compare its counts."""
        for name, frames in episode.cameras.items():
            if frames.error:
                self.tally.add(f"images of {name} cannot be read ({frames.error})", episode.key)
            elif frames.count is not None and frames.count != episode.length:
                where = f"{episode.key} ({frames.count} images, {episode.length} steps)"
                self.tally.add(f"{name} has another number of images than there are steps", where)


class FrozenFrames(DemonstrationCheck):
    """Images change while the robot moves.

    ## What it does
    Finds images that equal the one before, byte by byte, while the robot moves: more than four in a row, or more than
    half of all.

    ## Why it matters
    A frozen camera shows the past. A policy learns to act on what it does not see.

    ## Example
    `wrist` shows one image for 60 steps in the middle of an episode.

    ## Use instead
    Leave the episode out; record a camera that is slower than the control rate at its own rate.

    ## Fix safety
    No automatic fix.
    """

    code, slug, severity, needs_images = "XPL703", "frozen-frames", "should", True

    def inspect(self, episode: EpisodeData) -> None:
        """Check for repeated images."""
        for name, frames in episode.cameras.items():
            side = _side(name)
            moves = _moving_steps(episode, side)
            if frames.repeats is None or not len(frames.repeats) or moves is None:
                continue
            if side and frames.repeats.all() and not any(_side(column) == side for column in episode.columns):
                continue  # the wrist camera of an arm that may be at rest
            count = min(len(moves), len(frames.repeats))
            is_frozen = frames.repeats[:count] & moves[:count]
            longest = _longest_run(is_frozen)
            share = is_frozen.sum() / max(int(moves[:count].sum()), 1)
            if longest > _FROZEN or share > _SHARE:
                where = f"{episode.key} ({longest} in a row, {100 * share:.0f} % of the steps that move)"
                self.tally.add(f"{name} shows the same image while the robot moves", where)


def _side(name: str) -> str:
    """Return the side that a name says, "" if it says none."""
    return "".join({"left", "right"} & set(words(name)))


def _moving_steps(episode: EpisodeData, side: str) -> np.ndarray | None:
    """Return in which steps (T - 1,) the robot clearly moves, None where no state column shows it.

    For a camera of one side, only the columns of that side count, where columns have sides.
    """
    sided = side and any(_side(name) == side for name in episode.columns)
    speeds = [
        np.linalg.norm(np.diff(rows, axis=0), axis=1)
        for name, rows in episode.columns.items()
        if (not sided or _side(name) == side)
        and role_of(name) == STATE
        and len(rows) == episode.length > 2
        and np.isfinite(rows).all()
    ]
    fast = [speed > 0.2 * np.quantile(speed, 0.95) for speed in speeds if speed.max() > 0]
    return np.any(fast, axis=0) if fast else None


def _longest_run(flags: np.ndarray) -> int:
    """Return the length of the longest run of truths."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


class _FirstFrameCheck(DemonstrationCheck):
    """Compares the first images of a camera among the episodes."""

    needs_images = True

    def __init__(self, dataset: DatasetInfo) -> None:
        super().__init__(dataset)
        self._first: dict[str, list[tuple[str, np.ndarray]]] = {}

    def inspect(self, episode: EpisodeData) -> None:
        """Keep its first images."""
        for name, frames in episode.cameras.items():
            if frames.first is not None and frames.first.ndim == 3:
                self._first.setdefault(name, []).append((episode.key, frames.first))

    def _frames_and_median(self) -> Iterator[tuple[str, str, np.ndarray, np.ndarray]]:
        """Yield camera, episode, its first image, and the median of all of that camera."""
        enough = {
            name: frames_of_camera for name, frames_of_camera in self._first.items() if len(frames_of_camera) >= _FEWEST
        }
        if not enough:
            raise NotApplicable(f"fewer than {_FEWEST} episodes have images that could be compared")
        for name, frames_of_camera in enough.items():
            size = frames_of_camera[0][1].shape
            same = [(key, image) for key, image in frames_of_camera if image.shape == size]
            some = np.stack([same[index][1] for index in spread(len(same), _MOST_COMPARED)])
            usual = np.median(some.astype(np.float32), axis=0)
            for key, image in same:
                yield name, key, image.astype(np.float32), usual


def _correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Return the correlation of two images, 0 where one has no content."""
    a, b = one.ravel() - one.mean(), other.ravel() - other.mean()
    length = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / length if length > 1e-6 * one.size else 0.0


class MirroredCamera(_FirstFrameCheck):
    """No episode has a camera mirrored, or upside down, relative to the others.

    ## What it does
    Correlates each first image with the median of the first images of that camera: as it is, mirrored, upside down and
    rotated by 180 degrees. A correlation that is higher by 0.25, and at least 0.6, is a finding.

    ## Why it matters
    A camera that was mounted or read the other way for a day swaps left and right in some episodes.

    ## Example
    Episodes 40 to 49 were recorded after the camera driver was changed.

    ## Use instead
    Rotate or mirror the images of these episodes when you convert.

    ## Fix safety
    No automatic fix.
    """

    code, slug, severity = "XPL712", "camera-mirrored", "must"

    def findings(self) -> Iterator[Finding]:
        """Yield cameras that are mirrored in some episodes."""
        for name, key, image, usual in self._frames_and_median():
            plain = _correlation(image, usual)
            ways = {
                "mirrored": image[:, ::-1],
                "upside down": image[::-1],
                "rotated by 180 degrees": image[::-1, ::-1],
            }
            correlations = {way: _correlation(turned, usual) for way, turned in ways.items()}
            way = max(correlations, key=lambda one: correlations[one])
            if correlations[way] > 0.6 and correlations[way] - plain > 0.25:
                where = f"{key} (correlation {correlations[way]:.2f} so, {plain:.2f} as it is)"
                self.tally.add(f"{name} is {way} relative to the other episodes", where)
        yield from self.tally.findings()


class SwappedColours(_FirstFrameCheck):
    """No episode has red and blue swapped relative to the others.

    ## What it does
    Compares the difference of red and blue of each first image with that of the median of the first images of that
    camera. Where it is its opposite, and exchanging the two makes it alike by 0.5 at least, that is a finding.

    ## Why it matters
    OpenCV reads BGR. An episode that was written by another script than the others shows red objects blue, and an
    instruction that names a colour becomes false.

    ## Example
    The episodes of one operator show a blue cube where the instruction says red.

    ## Use instead
    Swap the channels of these episodes when you convert. If all episodes are swapped, this check finds nothing:
    `xpl data probe` checks the colours that instructions name.

    ## Fix safety
    No automatic fix.
    """

    code, slug, severity = "XPL713", "camera-colours", "must"

    def findings(self) -> Iterator[Finding]:
        """Yield cameras whose colours are exchanged in some episodes."""
        for name, key, image, usual in self._frames_and_median():
            warmth, normal = image[..., 0] - image[..., 2], usual[..., 0] - usual[..., 2]
            if normal.std() < 3 or warmth.std() < 3:
                continue  # too grey to tell
            own = float((warmth * normal).sum() / np.sqrt((warmth**2).sum() * (normal**2).sum()))
            if own < -0.5:
                self.tally.add(f"{name} has red and blue swapped relative to the other episodes", f"{key} ({own:.2f})")
        yield from self.tally.findings()
