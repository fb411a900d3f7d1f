"""Cameras by ray casting: colour, depth and segmentation from `mj_multiRay`, with no graphics stack.

A ray goes through the centre of every pixel. Room and table are met in closed form (`backdrop`); rays through MuJoCo
are cast only where the bounding box of another geom is seen. Pixels are repeatable, depth and segmentation exact.
Shading is a table look-up: half Lambert with one light, which shows the shape of surfaces that face away, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from .backdrop import Backdrop
from .scene import BACKDROP_GROUP

if TYPE_CHECKING:
    from numpy.typing import NDArray

_TO_LIGHT = np.array([0.35, -0.45, 0.82]) / math.sqrt(0.35**2 + 0.45**2 + 0.82**2)
_AMBIENT = 0.4
_LEVELS = 64
_FAR = 20.0  # m; nothing in the room is farther
_NEAR = 1e-3  # m; nearer than this a bounding box is cut off

_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
# Edges of a box: pairs of corners that differ in one coordinate.
_EDGES = np.array([(i, j) for i in range(8) for j in range(i + 1, 8) if np.sum(_CORNERS[i] != _CORNERS[j]) == 1])
_GROUPS = np.array([group != BACKDROP_GROUP for group in range(6)], dtype=np.uint8)


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


class RayCamera:
    """One named camera of a compiled model at one resolution.

    Args:
        model: `mujoco.MjModel`; position, mount and vertical field of view are the model's.
        name: the camera's name in the model.
        width: pixels.
        height: pixels.
        backdrop: the still surroundings.
    """

    def __init__(self, model: Any, name: str, width: int, height: int, backdrop: Backdrop) -> None:
        self._model, self._backdrop = model, backdrop
        self._id = model.camera(name).id
        self._still = model.cam_bodyid[self._id] == 0
        self._seen_backdrop: tuple[NDArray[np.int32], NDArray[np.float32]] | None = None
        self.width, self.height = width, height
        focal = 0.5 * height / math.tan(0.5 * math.radians(float(model.cam_fovy[self._id])))
        # A pixel's coordinates are those of its centre and the first is (0, 0), as in OpenCV.
        center = (0.5 * (width - 1), 0.5 * (height - 1))
        self.intrinsics = np.array([[focal, 0.0, center[0]], [0.0, focal, center[1]], [0.0, 0.0, 1.0]])
        x, y = np.meshgrid((np.arange(width) - center[0]) / focal, (np.arange(height) - center[1]) / focal)
        rays = np.stack([x.ravel(), y.ravel(), np.ones(width * height)])
        length = np.sqrt(np.sum(rays * rays, axis=0))
        self._rays = rays / length
        self._along_axis = (1.0 / length).astype(np.float32)
        self._solid = np.flatnonzero((model.geom_group != BACKDROP_GROUP) & (model.geom_rgba[:, 3] > 0))
        self._shades = _shades(model, backdrop)
        # Row of the shade table and geom of each surface of the backdrop; entry -1, the last, is nothing.
        self._surface_rows = np.arange(len(backdrop.surfaces) + 1, dtype=np.int32) + model.ngeom * _LEVELS
        self._surface_geoms = np.array([surface.geom for surface in backdrop.surfaces] + [-1], dtype=np.int32)

    def extrinsics(self, data: Any) -> NDArray[np.float64]:
        """Return the (4, 4) matrix that maps world points to the camera: x right, y down, z forward."""
        turn = self._axes(data).T
        matrix = np.eye(4)
        matrix[:3, :3] = turn
        matrix[:3, 3] = -np.sum(turn * data.cam_xpos[self._id], axis=-1)
        return matrix

    def render(self, data: Any) -> Frame:
        """Return what the camera sees in the present state of `data`, whose kinematics must be up to date."""
        origin, axes = data.cam_xpos[self._id], self._axes(data)
        directions = axes @ self._rays
        surface, nearest = self._see_backdrop(origin, directions)
        rows, segmentation = self._surface_rows[surface], self._surface_geoms[surface]
        distance = np.where(surface >= 0, nearest, np.float32(0.0))

        pixels = np.flatnonzero(self._covered(data, origin, axes))
        hit, length, normal = self._cast(data, origin, directions[:, pixels])
        seen = (hit >= 0) & (length < nearest[pixels])
        pixels, hit = pixels[seen], hit[seen]
        level = (normal[seen] @ _TO_LIGHT + 1.0) * (0.5 * (_LEVELS - 1)) + 0.5
        rows[pixels] = hit * _LEVELS + level.astype(np.int32)
        segmentation[pixels] = hit
        distance[pixels] = length[seen]

        shape = (self.height, self.width)
        color = self._shades.take(rows, axis=0)
        return Frame(
            color=color.reshape(*shape, 3),
            depth=(distance * self._along_axis).reshape(shape),
            segmentation=segmentation.reshape(shape),
        )

    def _see_backdrop(
        self, origin: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Cast at the backdrop; for a camera that never moves, once."""
        if self._seen_backdrop is not None:
            return self._seen_backdrop
        seen = self._backdrop.cast(origin, directions.astype(np.float32))
        if self._still:
            self._seen_backdrop = seen
        return seen

    def _cast(
        self, data: Any, origin: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
        """Return geom (n,), distance (n,) and normal (n, 3) of what rays (3, n) meet outside the backdrop."""
        count = directions.shape[1]
        hit, length, normal = np.empty(count, dtype=np.int32), np.empty(count), np.empty(3 * count)
        if count:
            rays = np.ascontiguousarray(directions.T).reshape(-1)
            mujoco.mj_multiRay(self._model, data, origin, rays, _GROUPS, 1, -1, hit, length, normal, count, _FAR)
        return hit, length, normal.reshape(-1, 3)

    def _covered(self, data: Any, origin: NDArray[np.float64], axes: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which pixels (H * W) lie in the image of some geom's bounding box; the backdrop does not count."""
        boxes = self._model.geom_aabb[self._solid]
        local = boxes[:, None, :3] + _CORNERS * boxes[:, None, 3:]
        turns = data.geom_xmat[self._solid].reshape(-1, 3, 3)
        world = data.geom_xpos[self._solid][:, None] + np.einsum("gij,gcj->gci", turns, local)
        corners = (world - origin) @ axes
        # Cut each edge off at the near plane: of an end behind it, keep the point where the edge crosses.
        a, b = corners[:, _EDGES[:, 0]], corners[:, _EDGES[:, 1]]
        ends = np.concatenate([_cut(a, b), _cut(b, a)], axis=1)
        focal, (cx, cy) = self.intrinsics[0, 0], self.intrinsics[:2, 2]
        u, v = focal * ends[..., 0] / ends[..., 2] + cx, focal * ends[..., 1] / ends[..., 2] + cy
        # Where no end of any edge is in front, fmin and fmax meet only NaN: such a box is not seen.
        left, right = _bounds(u, self.width)
        top, bottom = _bounds(v, self.height)
        mask = np.zeros((self.height, self.width), dtype=np.bool_)
        for x0, x1, y0, y1 in zip(left, right, top, bottom, strict=True):
            mask[y0:y1, x0:x1] = True
        return mask.reshape(-1)

    def _axes(self, data: Any) -> NDArray[np.float64]:
        """Return the camera's axes (3, 3) in the world as columns; MuJoCo's camera looks along -z with y up."""
        axes: NDArray[np.float64] = data.cam_xmat[self._id].reshape(3, 3) * np.array([1.0, -1.0, -1.0])
        return axes


def _cut(near: NDArray[np.float64], far: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move the ends `near` (..., 3) that lie behind the near plane along their edge onto it; NaN if both ends do."""
    depth, other = near[..., 2:], far[..., 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = near + (_NEAR - depth) / (other - depth) * (far - near)
    return np.where(depth >= _NEAR, near, np.where(other >= _NEAR, crossing, np.nan))


def _bounds(values: NDArray[np.float64], size: int) -> tuple[list[int], list[int]]:
    """Return first and one past the last pixel, within the image, of coordinates (G, points) that may be NaN."""
    low = np.fmin.reduce(values, axis=1)
    high = np.fmax.reduce(values, axis=1)
    first = np.clip(np.nan_to_num(np.floor(low), nan=0.0), 0, size).astype(int)
    last = np.clip(np.nan_to_num(np.ceil(high) + 1, nan=0.0), 0, size).astype(int)
    return first.tolist(), last.tolist()


def _shades(model: Any, backdrop: Backdrop) -> NDArray[np.uint8]:
    """Return RGB rows: one per geom and level of light, then one per surface of the backdrop, then black."""
    lit = model.geom_rgba[:, None, :3] * _light(np.linspace(-1.0, 1.0, _LEVELS))[None, :, None]
    normals = np.array([surface.normal for surface in backdrop.surfaces]).reshape(-1, 3)
    colors = model.geom_rgba[[surface.geom for surface in backdrop.surfaces], :3]
    still = colors * _light(normals @ _TO_LIGHT)[:, None]
    rows = np.concatenate([lit.reshape(-1, 3), still, np.zeros((1, 3))])
    shades: NDArray[np.uint8] = np.round(255.0 * np.clip(rows, 0.0, 1.0)).astype(np.uint8)
    return shades


def _light(cosine: NDArray[np.float64]) -> NDArray[np.float64]:
    brightness: NDArray[np.float64] = _AMBIENT + (1.0 - _AMBIENT) * (0.5 + 0.5 * cosine) ** 1.5
    return brightness
