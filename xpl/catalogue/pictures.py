"""What changes of pictures are written with: in what is shown, and in the steps of the block."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Callable, Optional

import numpy as np

from xpl import _spec as spec
from xpl.catalogue import convention as catalogue
from xpl.catalogue.edits import GONE, Block, Change, Site
from xpl.catalogue.mistake import Case, Mistake, Obs, Shown
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl.contract import Entry, ObservationDict

_NOMINAL = (480, 640)
"""Height and width for which a change of geometry has to leave the model's size."""

Picture = np.ndarray
Of = Callable[[Picture], Picture]

# -- shown -------------------------------------------------------------------------------------------------------------


def shown(rank: int, words: str, convention: str, change: Of, case: Case) -> Iterator[Mistake]:
    """Yield a change of the pictures that are shown: of all cameras, of each, and of both wrists."""
    cameras = case.cameras
    if not cameras:
        return
    yield Mistake(rank, words, convention, shown=seen(change, cameras))
    if len(cameras) > 1:
        for camera in cameras:
            yield Mistake(rank + 1, f"{words} ({camera})", convention, shown=seen(change, [camera]))
    wrists = [camera for camera in cameras if "wrist" in camera]
    if len(cameras) > 2 and rank < 2 and len(wrists) == 2:
        yield Mistake(rank + 1, f"{words} (wrist cameras)", convention, shown=seen(change, wrists))


def seen(change: Of, cameras: Sequence[str]) -> Shown:
    """Return the change of what some cameras show."""

    def entry(camera: str, was: Entry) -> Entry:
        if camera not in cameras or spec.Camera.COLOR not in was:
            return was
        return {**was, spec.Camera.COLOR: np.ascontiguousarray(change(was[spec.Camera.COLOR]))}

    return lambda observations: [_mapped(obs, entry) for obs in observations]


def placed(places: Mapping[str, str]) -> Shown:
    """Return the change that shows each camera another one's picture."""

    def exchanged(obs: Obs) -> ObservationDict:
        vision = obs.get(spec.Obs.VISION) or {}
        return _mapped(obs, lambda camera, was: vision.get(places.get(camera, camera), was))

    return lambda observations: [exchanged(obs) for obs in observations]


def dark(camera: str) -> Shown:
    """Return the change that shows one camera's pictures black."""
    return seen(np.zeros_like, [camera])


def _mapped(obs: Obs, change: Callable[[str, Entry], Entry]) -> ObservationDict:
    vision = obs.get(spec.Obs.VISION) or {}
    return {**obs, spec.Obs.VISION: {camera: change(camera, entry) for camera, entry in vision.items()}}


# -- in the block ------------------------------------------------------------------------------------------------------

StepEntry = dict[str, Any]
"""One of `images[].steps`: its word and how."""
Steps = list[StepEntry]
StepsChange = Callable[[Steps], Optional[Steps]]
"""Returns what becomes of the steps of an image, or None where the change has no meaning."""


def sites(block: Block) -> list[Site]:
    """Return the image inputs of a block."""
    return [Site(("images", at), entry, "", entry["input"]) for at, entry in enumerate(block.get("images") or ())]


def stepped(change: StepsChange) -> Change:
    """Return the change of an image input that `change` makes of its steps, if its size stays."""

    def of(entry: Block) -> Block | None:
        steps: Steps = list(entry.get("steps", ()))
        changed = change(steps)
        if changed is None or changed == steps or _size(steps) != _size(changed):
            return None
        return {"steps": changed or GONE}

    return of


def shape_after(word: str, how: Any, shape: tuple[int, int]) -> tuple[int, int]:
    """Return height and width after one step."""
    step: catalogue.Step = catalogue.found("steps", word)
    return step.shape(how, shape)


def _size(steps: Steps) -> tuple[int, int] | None:
    shape = _NOMINAL
    try:
        for step in steps:
            ((word, how),) = step.items()
            shape = shape_after(word, how, shape)
    except ConversionError:  # a crop that is larger than the nominal image
        return None
    return shape


def appended(step: StepEntry) -> StepsChange:
    """Add a step at the end where there is none of its word."""
    return lambda steps: None if any(step.keys() == one.keys() for one in steps) else [*steps, step]


def prepended(step: StepEntry) -> StepsChange:
    """Add a step before the others where there is none of its word."""
    return lambda steps: None if not steps or any(step.keys() == one.keys() for one in steps) else [step, *steps]


def lacking(word: str) -> StepsChange:
    """Take all steps of a word out."""
    return lambda steps: [step for step in steps if word not in step]


def replaced(word: str, by: StepEntry) -> StepsChange:
    """Put a step in the place of those of a word."""
    return lambda steps: [by if word in step else step for step in steps]


def inside(words: Sequence[str], key: str, value: Any, default: Any) -> StepsChange:
    """Say something in each step of some words; a default is not written."""

    def change(steps: Steps) -> Steps:
        result = []
        for step in steps:
            ((name, how),) = step.items()
            if name not in words or how.get(key, default) == value:
                result.append(step)
                continue
            told = {} if value == default else {key: value}
            result.append({name: {**{word: one for word, one in how.items() if word != key}, **told}})
        return result

    return change
