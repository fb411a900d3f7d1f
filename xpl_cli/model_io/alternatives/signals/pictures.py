"""Pictures as models see them: colours, cameras, orientation, geometry, numbers."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl.convert.parts import Numbers
from xpl.convert.resample import resize
from xpl_cli.model_io.alternatives.signals.signal import Obs, Shown, Signal

if TYPE_CHECKING:
    from xpl.contract import Entry, ObservationDict

_FRACTIONS = (1, 0.9, 0.95, 0.875, 0.8, 0.85)
Picture = Numbers
_Change = Callable[[Picture], Picture]


def pictures(cameras: Sequence[str]) -> Iterator[Signal]:
    """Yield changes of pictures: of all cameras, and of each."""
    for words, convention, rank, change in _CHANGES:
        yield Signal(rank, words, convention, _seen(change, cameras))
        if len(cameras) > 1:
            for camera in cameras:
                yield Signal(rank + 1, f"{words} ({camera})", convention, _seen(change, [camera]))
        if len(cameras) > 2 and rank < 2:
            wrists = [camera for camera in cameras if "wrist" in camera]
            if len(wrists) == 2:
                yield Signal(rank + 1, f"{words} (wrist cameras)", convention, _seen(change, wrists))
    yield from _crops(cameras)
    yield from _exchanges(cameras)


def wrists(obs: Obs) -> Obs:
    """Return an observation whose wrist cameras are exchanged."""
    left, right = spec.CAMERAS[2][-2:]
    return _placed({left: right, right: left})([obs])[0]


def _crops(cameras: Sequence[str]) -> Iterator[Signal]:
    for wanted, done in itertools.permutations(_FRACTIONS, 2):
        told = "no crop" if wanted == 1 else f"crop: {wanted}"
        words = told if done == 1 else f"{told}, not {done}"
        yield Signal(2, words, "image_size", _seen(partial(_framed, wanted=wanted, done=done), cameras))


def _exchanges(cameras: Sequence[str]) -> Iterator[Signal]:
    for one, other in itertools.combinations(cameras, 2):
        rank = 0 if "wrist" in one and "wrist" in other else 1
        words = f"cameras: {one} and {other} exchanged"
        yield Signal(rank, words, "camera", _placed({one: other, other: one}))
    for one, other in itertools.permutations(cameras, 2):
        yield Signal(2, f"cameras: {other} instead of {one}", "camera", _placed({one: other}))
    if len(cameras) > 2:
        for turned in (1, -1):
            order = [*cameras[turned:], *cameras[:turned]]
            yield Signal(2, f"cameras: {', '.join(order)}", "camera", _placed(dict(zip(cameras, order, strict=True))))


def dark(camera: str) -> Shown:
    """Return the change that shows one camera's pictures black."""
    return _seen(np.zeros_like, [camera])


def _mapped(obs: Obs, change: Callable[[str, Entry], Entry]) -> ObservationDict:
    vision = obs.get(spec.Obs.VISION) or {}
    return {**obs, spec.Obs.VISION: {camera: change(camera, entry) for camera, entry in vision.items()}}


def _seen(change: _Change, cameras: Sequence[str]) -> Shown:
    def entry(camera: str, was: Entry) -> Entry:
        if camera not in cameras or spec.Camera.COLOR not in was:
            return was
        return {**was, spec.Camera.COLOR: np.ascontiguousarray(change(was[spec.Camera.COLOR]))}

    return lambda observations: [_mapped(obs, entry) for obs in observations]


def _placed(places: Mapping[str, str]) -> Shown:
    """Return the change that shows each camera another one's picture."""

    def exchanged(obs: Obs) -> ObservationDict:
        vision = obs.get(spec.Obs.VISION) or {}
        return _mapped(obs, lambda camera, was: vision.get(places.get(camera, camera), was))

    return lambda observations: [exchanged(obs) for obs in observations]


def _squared(picture: Picture, *, how: str) -> Picture:
    height, width = picture.shape[:2]
    if how == "crop":
        side = min(height, width)
        top, left = (height - side) // 2, (width - side) // 2
        return picture[top : top + side, left : left + side]
    side = max(height, width)
    if how == "stretch":
        return resize(picture, (side, side), "bilinear")
    frame = np.zeros((side, side, picture.shape[2]), picture.dtype)
    top, left = (side - height) // 2, (side - width) // 2
    frame[top : top + height, left : left + width] = picture
    return frame


def _framed(picture: Picture, *, wanted: float, done: float) -> Picture:
    """Return a picture whose middle, as much as the adapter cuts out, is the middle that the model should see."""
    shape = np.array(picture.shape[:2])
    kept = (shape * wanted).astype(int)
    size = np.ceil(kept / done).astype(int)
    frame = np.zeros((*size, picture.shape[2]), picture.dtype)
    to, of = (size - kept) // 2, (shape - kept) // 2
    frame[to[0] : to[0] + kept[0], to[1] : to[1] + kept[1]] = picture[of[0] : of[0] + kept[0], of[1] : of[1] + kept[1]]
    return frame


def _linear(picture: Picture, *, scale: float, offset: float) -> Picture:
    return np.clip(np.rint(picture * scale + offset), 0, 255).astype(np.uint8)


def _reversed(picture: Picture) -> Picture:
    return picture[..., ::-1]


_CHANGES: tuple[tuple[str, str, int, _Change], ...] = (
    ("channels: red and blue exchanged", "image_channels", 0, _reversed),
    ("rotate: 180", "image_orientation", 0, lambda picture: picture[::-1, ::-1]),
    ("mirror: left_right", "image_orientation", 0, lambda picture: picture[:, ::-1]),
    ("mirror: up_down", "image_orientation", 1, lambda picture: picture[::-1]),
    ("padded to a square", "image_size", 1, partial(_squared, how="pad")),
    ("cropped to a square", "image_size", 1, partial(_squared, how="crop")),
    ("stretched to a square", "image_size", 1, partial(_squared, how="stretch")),
    ("range: 0 to 1, not -1 to 1", "image_range", 1, partial(_linear, scale=0.5, offset=127.5)),
    ("range: -1 to 1, not 0 to 1", "image_range", 1, partial(_linear, scale=2.0, offset=-255.0)),
)
