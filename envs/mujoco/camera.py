"""Cameras: what any renderer is asked for, and the default one, by ray casting with no graphics stack.

A ray goes through the centre of every pixel, and every shape is met in closed form (`shapes`) in the rectangle of
pixels that its bounding box can cover. Pixels are repeatable, depth and segmentation exact. Shading is a table look-up:
half Lambert with the model's one light, which shows the shape of surfaces that face away, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from .scene import BACKDROP_GROUP
from .shapes import MEETINGS, Placed, View

if TYPE_CHECKING:
    from numpy.typing import NDArray

_LEVELS = 64
_NEAR = 1e-3  # m; nearer than this a bounding box is cut off
_BAND = 1 << 15  # pixels met at once: their intermediate results stay in the processor's cache

_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
# Edges of a box: pairs of corners that differ in one coordinate.
_EDGES = np.array([(i, j) for i in range(8) for j in range(i + 1, 8) if np.sum(_CORNERS[i] != _CORNERS[j]) == 1])


@dataclass(frozen=True)
class Frame:
    """What one camera sees.

    Attributes:
        color: (H, W, 3) uint8, RGB.
        depth: (H, W) float32, m along the optical axis; 0 where there is nothing.
        segmentation: (H, W) int32, geom id of the compiled model, -1 for nothing.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    segmentation: NDArray[np.int32]


class Camera:
    """One named camera of a compiled model at one resolution: its geometry, whatever draws the picture.

    Args:
        model: `mujoco.MjModel`; position, mount and vertical field of view are the model's.
        name: the camera's name in the model.
        width: pixels.
        height: pixels.

    Attributes:
        intrinsics: (3, 3) float64. A pixel's coordinates are those of its centre and the first is (0, 0), as in OpenCV.
    """

    def __init__(self, model: Any, name: str, width: int, height: int) -> None:
        self.model, self.id = model, int(model.camera(name).id)
        self.width, self.height = width, height
        focal = 0.5 * height / math.tan(0.5 * math.radians(float(model.cam_fovy[self.id])))
        center = (0.5 * (width - 1), 0.5 * (height - 1))
        self.intrinsics = np.array([[focal, 0.0, center[0]], [0.0, focal, center[1]], [0.0, 0.0, 1.0]])

    def axes(self, data: Any) -> NDArray[np.float64]:
        """Return the camera's axes (3, 3) in the world as columns: x right, y down, z forward."""
        # MuJoCo's camera looks along -z with y up.
        axes: NDArray[np.float64] = data.cam_xmat[self.id].reshape(3, 3) * np.array([1.0, -1.0, -1.0])
        return axes

    def extrinsics(self, data: Any) -> NDArray[np.float64]:
        """Return the (4, 4) matrix that maps world points to the camera."""
        turn = self.axes(data).T
        matrix = np.eye(4)
        matrix[:3, :3] = turn
        matrix[:3, 3] = -np.sum(turn * data.cam_xpos[self.id], axis=-1)
        return matrix

    def render(self, data: Any) -> Frame:
        """Return what the camera sees in the present state of `data`, whose kinematics must be up to date."""
        raise NotImplementedError


@dataclass
class _Canvas:
    """A picture in the making: what is nearest at every pixel, (H, W) each."""

    depth: NDArray[np.float32]
    rows: NDArray[np.int32]  # of the shade table

    def copy(self) -> _Canvas:
        return _Canvas(self.depth.copy(), self.rows.copy())


class RayCamera(Camera):
    """A camera that casts rays at the model's planes, boxes, spheres, capsules and cylinders.

    Args:
        model: `mujoco.MjModel` with a light; the first one counts.
        name: the camera's name in the model.
        width: pixels.
        height: pixels.

    Raises:
        ValueError: the model has a visible geom of another type.
    """

    def __init__(self, model: Any, name: str, width: int, height: int) -> None:
        super().__init__(model, name, width, height)
        (focal, _, cx), (_, _, cy), _ = self.intrinsics.tolist()
        x, y = (np.arange(width) - cx) / focal, (np.arange(height) - cy) / focal
        self._view = View(x[None, :].astype(np.float32), y[:, None].astype(np.float32))
        visible = np.flatnonzero(model.geom_rgba[:, 3] > 0)
        for geom in visible.tolist():
            if int(model.geom_type[geom]) not in MEETINGS:
                raise ValueError(f"geom {model.geom(geom).name!r} is no plane, box, sphere, capsule or cylinder")
        backdrop = model.geom_group[visible] == BACKDROP_GROUP
        self._still, self._moving = visible[backdrop], visible[~backdrop]
        # A camera that stands still sees the same room and table every time.
        self._stands = int(model.cam_bodyid[self.id]) == 0
        self._backdrop: _Canvas | None = None
        self._shades = _shades(model)
        self._geoms = np.append(np.repeat(np.arange(model.ngeom, dtype=np.int32), _LEVELS), np.int32(-1))

    def render(self, data: Any) -> Frame:
        """Return what the camera sees in the present state of `data`, whose kinematics must be up to date."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # rays that miss
            canvas = self._surroundings(data)
            self._draw(canvas, data, self._moving)
        canvas.depth[np.isinf(canvas.depth)] = 0.0
        return Frame(
            color=self._shades.take(canvas.rows, axis=0),
            depth=canvas.depth,
            segmentation=self._geoms.take(canvas.rows),
        )

    def _surroundings(self, data: Any) -> _Canvas:
        """Return a picture of room and table alone."""
        if self._backdrop is not None:
            return self._backdrop.copy()
        shape = (self.height, self.width)
        nothing = len(self._geoms) - 1
        canvas = _Canvas(np.full(shape, np.inf, dtype=np.float32), np.full(shape, nothing, dtype=np.int32))
        self._draw(canvas, data, self._still)
        if self._stands:
            self._backdrop = canvas.copy()
        return canvas

    def _draw(self, canvas: _Canvas, data: Any, geoms: NDArray[np.intp]) -> None:
        model, axes = self.model, self.axes(data)
        turns = data.geom_xmat[geoms].reshape(-1, 3, 3)
        # From here on, in each geom's own axes.
        eyes = ((data.cam_xpos[self.id] - data.geom_xpos[geoms])[:, :, None] * turns).sum(axis=1)
        lights = (-data.light_xdir[0][:, None] * turns).sum(axis=1)
        turned = np.einsum("gji,jk->gik", turns, axes)
        boxes = self._rectangles(model.geom_aabb[geoms], eyes, turned)
        for index, geom in enumerate(geoms.tolist()):
            left, right, top, bottom = (
                boxes[index] if model.geom_type[geom] else (0, self.width, 0, self.height)  # a plane is everywhere
            )
            if left >= right:
                continue
            shape = Placed(eyes[index], turned[index], model.geom_size[geom], lights[index])
            height = max(1, _BAND // (right - left))
            for first in range(top, bottom, height):
                self._put(canvas, geom, shape, (left, right, first, min(first + height, bottom)))

    def _put(self, canvas: _Canvas, geom: int, shape: Placed, box: tuple[int, int, int, int]) -> None:
        """Draw one shape into a rectangle of the picture, where it is nearest."""
        left, right, top, bottom = box
        depth, cosine = MEETINGS[int(self.model.geom_type[geom])](self._view.cut(*box), shape)
        before = canvas.depth[top:bottom, left:right]
        nearer = (depth < before) & (depth > _NEAR)
        row = (cosine * np.float32(0.5 * (_LEVELS - 1)) + np.float32(0.5 * _LEVELS + geom * _LEVELS)).astype(np.int32)
        np.copyto(before, depth, where=nearer)
        np.copyto(canvas.rows[top:bottom, left:right], row, where=nearer)

    def _rectangles(
        self, bounds: NDArray[np.float64], eyes: NDArray[np.float64], turns: NDArray[np.float64]
    ) -> list[tuple[int, int, int, int]]:
        """Return the pixels (left, right, top, bottom; ends excluded) that cover the image of each bounding box.

        Args:
            bounds: (G, 6) centre and half extents in the geoms' axes.
            eyes: (G, 3) position of the camera in the geoms' axes.
            turns: (G, 3, 3) the geoms' axes in the camera's, as rows.
        """
        local = bounds[:, None, :3] + _CORNERS * bounds[:, None, 3:] - eyes[:, None]
        corners = np.einsum("gci,gik->gck", local, turns)
        # Cut each edge off at the near plane: of an end behind it, keep the point where the edge crosses.
        a, b = corners[:, _EDGES[:, 0]], corners[:, _EDGES[:, 1]]
        ends = np.concatenate([_cut(a, b), _cut(b, a)], axis=1)
        focal, (cx, cy) = self.intrinsics[0, 0], self.intrinsics[:2, 2]
        u, v = focal * ends[..., 0] / ends[..., 2] + cx, focal * ends[..., 1] / ends[..., 2] + cy
        return [
            (left, right, top, bottom) if top < bottom else (0, 0, 0, 0)
            for (left, right), (top, bottom) in zip(_range(u, self.width), _range(v, self.height), strict=True)
        ]


def _cut(near: NDArray[np.float64], far: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move the ends `near` (..., 3) that lie behind the near plane along their edge onto it; NaN if both ends do."""
    depth, other = near[..., 2:], far[..., 2:]
    crossing = near + (_NEAR - depth) / (other - depth) * (far - near)
    return np.where(depth >= _NEAR, near, np.where(other >= _NEAR, crossing, np.nan))


def _range(values: NDArray[np.float64], size: int) -> list[list[int]]:
    """Return first and one past the last pixel, within the image, of coordinates (G, points) that may be NaN."""
    # Where no end of any edge is in front, fmin and fmax meet only NaN: such a box is not seen.
    low, high = np.floor(np.fmin.reduce(values, axis=1)), np.ceil(np.fmax.reduce(values, axis=1)) + 1
    ends: list[list[int]] = np.clip(np.nan_to_num(np.stack([low, high], axis=1)), 0, size).astype(int).tolist()
    return ends


def _shades(model: Any) -> NDArray[np.uint8]:
    """Return RGB rows (geoms * levels + 1, 3): every geom at every level of light, then black."""
    cosine = np.linspace(-1.0, 1.0, _LEVELS)[:, None]
    brightness = model.vis.headlight.ambient + model.light_diffuse[0] * (0.5 + 0.5 * cosine) ** 1.5
    rows = np.concatenate([(model.geom_rgba[:, None, :3] * brightness).reshape(-1, 3), np.zeros((1, 3))])
    shades: NDArray[np.uint8] = np.round(255.0 * np.clip(rows, 0.0, 1.0)).astype(np.uint8)
    return shades
