"""Encoded images rebuilt with another geometry, whatever resize the adapter applies.

Black, white, red and ramp images identify the region of each camera in the encoded images, its value range, channel
order and orientation. These stay; the resize is exchanged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.catalogue.walk import EncodeOne, NoEffectError, channel_axis, leaves, map_leaves
from xpl.convert.images import ImageInput
from xpl.observation import get_image
from xpl.worker.encoded.pictures import whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl.contract import Entry, Observation

_MOST_CAMERAS = 8
_SEEN = 1e-6
"""Least share of the largest change by which a pixel belongs to a camera."""
_COLOURS = 3


@dataclass(frozen=True)
class _ImageRegion:
    """Region of a camera's image in the encoded inputs.

    Attributes:
        leaf, plane: index of the encoded array, and of the image in it.
        rows, columns: region in the image.
        black, white: values of black and white by channel, (3,).
        order: RGB index of each channel.
        is_turned: whether rows and columns are transposed.
        flips: whether rows, and columns, are reversed.
        is_alone: whether the image has no other camera.
    """

    leaf: int
    plane: int
    rows: slice
    columns: slice
    black: np.ndarray
    white: np.ndarray
    order: list[int]
    is_turned: bool
    flips: tuple[bool, bool]
    is_alone: bool


class RebuiltImages:
    """Rebuilds encoded images with another geometry.

    Args:
        encode: the adapter's `encode`.
        sample: an observation.

    Raises:
        NoEffectError: no camera has a region in the encoded images.
    """

    def __init__(self, encode: EncodeOne, sample: Observation) -> None:
        self._encode, self._sample = encode, sample
        self._cameras = [name for name, one in sample[spec.Obs.VISION].items() if spec.Camera.COLOR in one]
        black = self._planes({})
        if not black or len(self._cameras) > _MOST_CAMERAS:
            raise NoEffectError("no pictures")
        whites = {camera: self._planes({camera: np.full(_COLOURS, 255.0)}) for camera in self._cameras}
        self._regions: dict[str, list[_ImageRegion]] = {}
        for camera, white in whites.items():
            found = self._find_regions(camera, black, white, whites)
            if found:
                self._regions[camera] = found
        if not self._regions:
            raise NoEffectError("no camera is seen")

    def __call__(self, value: Any, obs: Observation, steps: Sequence[Entry], *, exchanged: bool = False) -> Any:
        """Return encoded inputs whose images were resized by other steps.

        Args:
            value: result of the adapter's `encode`.
            obs: the observation.
            steps: steps of a model_io block, without `to`.
            exchanged: whether height and width are exchanged.

        Raises:
            NoEffectError: an image joins several cameras, so that its height and width cannot be exchanged.
        """
        arrays = [_flat(leaf) for leaf in leaves(value) if channel_axis(leaf) is not None]
        made = [np.swapaxes(array, 1, 2).copy() if exchanged else array.copy() for array in arrays]
        for camera, places in self._regions.items():
            image = get_image(obs, camera)
            for place in places:
                if exchanged and not place.is_alone:
                    raise NoEffectError("several pictures in one")
                target = made[place.leaf][place.plane]
                if not exchanged:
                    target = target[place.rows, place.columns]
                target[...] = _made(image, place, steps, target.shape[:2])
        numbers = iter(made)

        def change(leaf: Any) -> Any:
            axis = channel_axis(leaf)
            if axis is None:
                return None
            array = next(numbers)
            array = np.moveaxis(array.reshape(*np.moveaxis(leaf, axis, -1).shape[:-3], *array.shape[1:]), -1, axis)
            return array if leaf.dtype.kind == "f" else np.rint(array).astype(leaf.dtype)

        return map_leaves(value, change)

    def _planes(self, colours: Mapping[str, np.ndarray]) -> list[np.ndarray]:
        """Return the encoded images of observations with these colours or images by camera, the others black."""
        vision = {}
        for name, was in self._sample[spec.Obs.VISION].items():
            shape = np.shape(was.get(spec.Camera.COLOR, ()))
            color = np.broadcast_to(colours.get(name, np.zeros(_COLOURS)), shape).astype(np.uint8) if shape else None
            vision[name] = {**was, spec.Camera.COLOR: color} if shape else was
        value = self._encode({**self._sample, spec.Obs.VISION: vision})
        return [_flat(leaf) for leaf in leaves(value) if channel_axis(leaf) is not None]

    def _find_regions(
        self,
        camera: str,
        black: Sequence[np.ndarray],
        white: Sequence[np.ndarray],
        whites: Mapping[str, Sequence[np.ndarray]],
    ) -> list[_ImageRegion]:
        """Return the regions of a camera's image."""
        height, width = np.shape(self._sample[spec.Obs.VISION][camera][spec.Camera.COLOR])[:2]
        colours = [self._planes({camera: one}) for one in 255.0 * np.eye(_COLOURS)]
        across = self._planes({camera: np.linspace(0, 255, width)[None, :, None]})
        down = self._planes({camera: np.linspace(0, 255, height)[:, None, None]})
        places = []
        for leaf, planes in enumerate(white):
            for plane in range(len(planes)):
                mask = _mask(planes[plane], black[leaf][plane])
                if not mask.any():
                    continue
                others = [_mask(one[leaf][plane], black[leaf][plane]) for one in whites.values()]
                boxes = [_centre(one) for one in others if one.any()]
                rows, columns = _shared(mask.shape, _centre(mask), boxes)
                moved = np.stack([np.abs(one[leaf][plane] - black[leaf][plane])[mask].sum(0) for one in colours])
                slopes = [_slopes(one[leaf][plane], mask) for one in (across, down)]
                is_turned = abs(slopes[0][0]) > abs(slopes[0][1])
                by_row, by_column = (slopes[0][0], slopes[1][1]) if is_turned else (slopes[1][0], slopes[0][1])
                lows, highs = (np.median(one[leaf][plane][mask], axis=0) for one in (black, white))
                sign = np.sign((highs - lows).sum())
                places.append(
                    _ImageRegion(
                        leaf=leaf,
                        plane=plane,
                        rows=rows,
                        columns=columns,
                        black=lows,
                        white=highs,
                        order=[int(one) for one in moved.argmax(0)],
                        is_turned=bool(is_turned),
                        flips=(bool(by_row * sign < 0), bool(by_column * sign < 0)),
                        is_alone=len(boxes) == 1,
                    )
                )
        return places


def _flat(leaf: np.ndarray) -> np.ndarray:
    """Return images as (N, H, W, 3) float64."""
    array = np.moveaxis(leaf, channel_axis(leaf) or -1, -1)
    return array.reshape(-1, *array.shape[-3:]).astype(np.float64)


def _mask(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    far = np.abs(one - other).max(-1)
    is_changed: np.ndarray = far > max(_SEEN, 0.5 * float(far.max()))
    return is_changed


def _centre(mask: np.ndarray) -> tuple[float, float]:
    rows, columns = np.nonzero(mask)
    return float(rows.mean()), float(columns.mean())


def _shared(
    shape: tuple[int, ...], own: tuple[float, float], boxes: Sequence[tuple[float, float]]
) -> tuple[slice, slice]:
    """Return the part of one camera in an image that joins several side by side or one below the other."""
    if len(boxes) < 2:
        return slice(0, shape[0]), slice(0, shape[1])
    axis = 0 if np.ptp([one[0] for one in boxes]) > np.ptp([one[1] for one in boxes]) else 1
    size, place = shape[axis] // len(boxes), sorted(one[axis] for one in boxes).index(own[axis])
    part = slice(place * size, (place + 1) * size)
    return (part, slice(0, shape[1])) if axis == 0 else (slice(0, shape[0]), part)


def _slopes(picture: np.ndarray, mask: np.ndarray) -> tuple[float, float]:
    """Return the slopes of an image by row and by column."""
    rows, columns = np.nonzero(mask)
    design = np.stack((rows, columns, np.ones(len(rows))), axis=-1)
    by_row, by_column, _ = np.linalg.lstsq(design, picture.sum(-1)[mask], rcond=None)[0]
    return float(by_row), float(by_column)


def _made(image: np.ndarray, region: _ImageRegion, steps: Sequence[Entry], size: Sequence[int]) -> np.ndarray:
    """Return a camera's image in the values of the encoded inputs."""
    shape = tuple(size)[::-1] if region.is_turned else tuple(size)
    entry = {"input": "", "channels": "rgb", "layout": "hwc", "dtype": "uint8", "cameras": [""]}
    made = ImageInput({**entry, "steps": whole(steps, shape, image.shape)}).view(image)
    view = np.swapaxes(made, 0, 1) if region.is_turned else made
    view = view[:: -1 if region.flips[0] else 1, :: -1 if region.flips[1] else 1]
    share = view[..., region.order].astype(np.float64) / 255.0
    numbers: np.ndarray = region.black + share * (region.white - region.black)
    return numbers
