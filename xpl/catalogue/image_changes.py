"""Changes of images: in observations, and in the steps of the block."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Callable, Optional

import numpy as np

from xpl import _spec as spec
from xpl.catalogue import convention as catalogue
from xpl.catalogue.edits import REMOVE, Block, EntryChange, Site
from xpl.catalogue.mistake import AdapterCase, Mistake, Obs, ObservationChange
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl.contract import Entry, ObservationDict

_NOMINAL = (480, 640)
"""Height and width at which a change of the steps must keep the model's input size."""

Picture = np.ndarray
ImageFunction = Callable[[Picture], Picture]

# -- shown -------------------------------------------------------------------------------------------------------------


def image_mistakes(
    rank: int, words: str, convention: str, change: ImageFunction, case: AdapterCase
) -> Iterator[Mistake]:
    """Yield a change of the images of all cameras, of each, and of both wrists.

    Args:
        rank: rank of the change of all cameras; 0 is the likeliest. Changes of fewer have the next one.
        words: description of the change.
        convention: name of its convention.
        change: from an image (H, W, 3) uint8 RGB to another one.
        case: the adapter, whose `cameras` are changed.
    """
    cameras = case.cameras
    if not cameras:
        return
    yield Mistake(rank, words, convention, change_observations=change_images(change, cameras))
    if len(cameras) > 1:
        for camera in cameras:
            yield Mistake(
                rank + 1, f"{words} ({camera})", convention, change_observations=change_images(change, [camera])
            )
    wrists = [camera for camera in cameras if "wrist" in camera]
    if len(cameras) > 2 and rank < 2 and len(wrists) == 2:
        yield Mistake(
            rank + 1, f"{words} (wrist cameras)", convention, change_observations=change_images(change, wrists)
        )


def change_images(change: ImageFunction, cameras: Sequence[str]) -> ObservationChange:
    """Return the change of the images of some cameras."""

    def entry(camera: str, was: Entry) -> Entry:
        if camera not in cameras or spec.Camera.COLOR not in was:
            return was
        return {**was, spec.Camera.COLOR: np.ascontiguousarray(change(was[spec.Camera.COLOR]))}

    return lambda observations: [_map_vision(obs, entry) for obs in observations]


def swap_cameras(places: Mapping[str, str]) -> ObservationChange:
    """Return the change that gives each camera the image of another one."""

    def exchanged(obs: Obs) -> ObservationDict:
        vision = obs.get(spec.Obs.VISION) or {}
        return _map_vision(obs, lambda camera, was: vision.get(places.get(camera, camera), was))

    return lambda observations: [exchanged(obs) for obs in observations]


def black_out(camera: str) -> ObservationChange:
    """Return the change that makes one camera's images black."""
    return change_images(np.zeros_like, [camera])


def _map_vision(obs: Obs, change: Callable[[str, Entry], Entry]) -> ObservationDict:
    vision = obs.get(spec.Obs.VISION) or {}
    return {**obs, spec.Obs.VISION: {camera: change(camera, entry) for camera, entry in vision.items()}}


# -- in the block ------------------------------------------------------------------------------------------------------

StepEntry = dict[str, Any]
"""One of `images[].steps`: its key and parameters."""
Steps = list[StepEntry]
StepsChange = Callable[[Steps], Optional[Steps]]
"""Returns the new steps of an image, or None if the change does not apply."""


def sites(block: Block) -> list[Site]:
    """Return the image inputs of a block."""
    return [Site(("images", at), entry, "", entry["input"]) for at, entry in enumerate(block.get("images") or ())]


def change_steps(change: StepsChange) -> EntryChange:
    """Return the change of an image input's steps by `change`, if its size stays or the model gets the camera's own."""

    def of(entry: Block) -> Block | None:
        steps: Steps = list(entry.get("steps", ()))
        changed = change(steps)
        if changed is None or changed == steps:
            return None
        if changed and _size(changed) not in (_size(steps), _NOMINAL):
            return None
        return {"steps": changed or REMOVE}

    return of


def shape_after(word: str, how: Any, shape: tuple[int, int]) -> tuple[int, int]:
    """Return height and width after one step.

    Args:
        word: kind of the step, such as crop.
        how: its parameters.
        shape: height and width before, pixels.

    Raises:
        ConversionError: a crop is larger than the image.
    """
    step: catalogue.GeometryStep = catalogue.lookup("steps", word)
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


def append_step(step: StepEntry) -> StepsChange:
    """Add a step at the end if there is none of its kind."""
    return lambda steps: None if any(step.keys() == one.keys() for one in steps) else [*steps, step]


def prepend_step(step: StepEntry) -> StepsChange:
    """Add a step before the others if there is none of its kind."""
    return lambda steps: None if not steps or any(step.keys() == one.keys() for one in steps) else [step, *steps]


def remove_steps(word: str) -> StepsChange:
    """Remove all steps of a kind."""
    return lambda steps: [step for step in steps if word not in step]


def replace_steps(word: str, by: StepEntry) -> StepsChange:
    """Replace the steps of a kind by a step."""
    return lambda steps: [by if word in step else step for step in steps]


def set_in_steps(words: Sequence[str], key: str, value: Any, default: Any) -> StepsChange:
    """Return the change that sets a key in each step of some kinds.

    Args:
        words: kinds of steps.
        key: key of their parameters.
        value: new value.
        default: value of a step without the key; to set it removes the key.
    """

    def change(steps: Steps) -> Steps:
        result = []
        for step in steps:
            ((name, how),) = step.items()
            if name not in words or how.get(key, default) == value:
                result.append(step)
                continue
            extra = {} if value == default else {key: value}
            result.append({name: {**{word: one for word, one in how.items() if word != key}, **extra}})
        return result

    return change
