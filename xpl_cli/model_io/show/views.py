"""Every image that a model gets, beside the camera's: as people would see it if the block is right, and as numbers."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl.convert.images import ImageInput
from xpl.manifest import ModelIO
from xpl.observation import get_image
from xpl_cli.model_io.show import image_transforms

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl.contract import Entry, Observation

_SIDES: Final = ("left", "right")
_PLACES: Final = {"wrist": ("wrist", "hand", "gripper"), "head": ("head", "top", "front", "high", "main", "agentview")}
"""Words by which names of inputs and cameras say where a camera is."""


@dataclass(frozen=True)
class ImageView:
    """One camera in one image input.

    Attributes:
        input: the model's name for it.
        camera_index: which of the input's cameras it is, from 0.
        camera: the standard's camera that the block says.
        when: observations ago; 0 is now.
        taken: (H, W, 3) uint8 RGB, the camera's picture.
        values: the model's numbers, (h, w, 3) whatever its layout.
        seen: (h, w, 3) uint8, as people see them if the block's words hold.
        shape: of the whole input, without batch and time.
        dtype: of the input.
        words: what the block says of it, in short.
        notes: what people should look at: mirrored, red and blue exchanged, another camera.
    """

    input: str
    camera_index: int
    camera: str
    when: int
    taken: np.ndarray
    values: np.ndarray
    seen: np.ndarray
    shape: tuple[int, ...]
    dtype: str
    words: tuple[str, ...]
    notes: tuple[str, ...] = field(default=())

    @property
    def raw(self) -> np.ndarray:
        """The numbers as a picture, (h, w, 3) uint8: the lowest black, the highest white, the first channel red."""
        low, high = float(self.values.min()), float(self.values.max())
        if self.values.dtype == np.uint8:
            return self.values
        scaled = (self.values - low) * (255.0 / (high - low if high > low else 1.0))
        result: np.ndarray = np.clip(scaled + 0.5, 0, 255).astype(np.uint8)
        return result

    def document(self) -> dict[str, Any]:
        """Return its numbers as JSON; channels in the model's order."""
        numbers = self.values.astype(np.float64)
        return {
            "input": self.input,
            "camera": self.camera,
            "observations_ago": self.when,
            "shape": list(self.shape),
            "dtype": self.dtype,
            "camera_shape": list(self.taken.shape),
            "words": list(self.words),
            "notes": list(self.notes),
            "channels": [
                {"min": float(one.min()), "mean": round(float(one.mean()), 6), "max": float(one.max())}
                for one in np.moveaxis(numbers, -1, 0)
            ],
        }


def views(model_io: Entry, inputs: Mapping[str, np.ndarray], observations: Sequence[Observation]) -> list[ImageView]:
    """Return what a model sees, input by input, newest first.

    Args:
        model_io: the block.
        inputs: what it gets, without a batch axis: (T, ...) where the block says that it has a history.
        observations: of the episode, oldest first.
    """
    histories = ModelIO.parse(model_io).histories("images")
    image_views = []
    for entry, history in zip(model_io.get("images", ()), histories, strict=True):
        if entry["input"] not in inputs:
            continue
        frames_given = np.asarray(inputs[entry["input"]])
        frames = frames_given if history.length > 1 else frames_given[None]
        ages = replace(history, length=len(frames)).ages  # an adapter's own encode may show another number
        for when, values in sorted(zip(ages, frames, strict=True), key=lambda one: one[0]):
            then = observations[max(0, len(observations) - 1 - when)]
            image_views += list(_of(entry, values, then, when))
    return image_views


def _of(entry: Entry, value: np.ndarray, observation: Observation, when: int) -> Iterator[ImageView]:
    item = ImageInput(entry)
    taken = {camera: get_image(observation, camera) for camera in item.cameras}
    for index, (camera, values, picture) in enumerate(
        zip(item.cameras, item.views(value), item.visible_images(value), strict=True)
    ):
        notes = [*_exchanged(entry, picture, taken, camera), *_misnamed(entry, camera)]
        yield ImageView(
            item.name,
            index,
            camera,
            when,
            taken[camera],
            np.ascontiguousarray(values),
            picture,
            tuple(value.shape),
            str(value.dtype),
            tuple(_words(entry)),
            tuple(notes),
        )


def _exchanged(entry: Entry, picture: np.ndarray, taken: Mapping[str, np.ndarray], camera: str) -> Iterator[str]:
    yield from image_transforms.describe_transform(picture, taken[camera], entry)
    nearest = min(taken, key=lambda name: image_transforms.difference(picture, taken[name], entry))
    if image_transforms.difference(picture, taken[nearest], entry) < 0.5 * image_transforms.difference(
        picture, taken[camera], entry
    ):
        yield f"shows {nearest}"


def _misnamed(entry: Entry, camera: str) -> Iterator[str]:
    """Yield what the input's own name says otherwise than the camera's."""
    if len(entry["cameras"]) > 1:
        return
    name, camera_words = (set(re.split(r"[^a-z]+", text.lower())) for text in (entry["input"], camera))
    for one, other in (_SIDES, _SIDES[::-1]):
        if one in name and other not in name and other in camera_words and one not in camera_words:
            yield f"the input is called {entry['input']}, and shows {camera}"
    kinds = [
        {kind for kind, words in _PLACES.items() if words_of_name & set(words)}
        for words_of_name in (name, camera_words)
    ]
    if kinds[0] and kinds[1] and not kinds[0] & kinds[1]:
        yield f"the input is called {entry['input']}, and shows {camera}"


def _words(entry: Entry) -> Iterator[str]:
    """Yield what the block says of an input, in its order."""
    for step in entry.get("steps", ()):
        ((kind, how),) = step.items()
        if isinstance(how, dict):
            values = " ".join(
                "x".join(map(str, value)) if isinstance(value, list) else str(value if value is not True else key)
                for key, value in how.items()
                if value is not False
            )
            yield f"{kind} {values}"
        else:
            yield f"{kind} {how}"
    yield f"channels {entry['channels']}"
    yield f"layout {entry['layout']}"
    yield entry["dtype"]
    if entry["dtype"] != "uint8":
        yield "range {} to {}".format(*entry.get("range", (0, 1)))
        if "mean" in entry or "std" in entry:
            yield f"mean {entry.get('mean', 0)} std {entry.get('std', 1)}"
    if "stack" in entry:
        yield f"stack {entry['stack']}"
