"""Where rays meet primitive shapes, in closed form, for whole rectangles of pixels at once.

Rays start at the camera and go through (x, y, 1) in its axes: the parameter at which one meets a shape is the depth
along the optical axis. They are not normalised, so that whatever is linear in the ray is a row plus a column
(`View.along`). float32, because depth to a micrometre is enough and half the memory is half the time; elementwise
operations only, which are rounded alike on every machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    Image = NDArray[np.float32]


@dataclass(frozen=True)
class View:
    """The rays of a rectangle of pixels.

    Attributes:
        x: (1, W) float32, first coordinate of every column's rays.
        y: (H, 1) float32, second coordinate of every row's rays.
    """

    x: Image
    y: Image

    def along(self, vector: NDArray[np.float64]) -> Image:
        """Return the product (H, W) of every ray with a vector (3,) in the camera's axes."""
        a, b, c = vector.astype(np.float32)
        image: Image = a * self.x + (b * self.y + c)
        return image

    def square(self) -> Image:
        """Return the squared length (H, W) of every ray."""
        image: Image = self.x * self.x + (self.y * self.y + np.float32(1.0))
        return image

    def cut(self, left: int, right: int, top: int, bottom: int) -> View:
        """Return the rays of the columns `left` to `right` and the rows `top` to `bottom`, ends excluded."""
        return View(self.x[:, left:right], self.y[top:bottom])


@dataclass(frozen=True)
class Placed:
    """A shape as one camera sees it, in the shape's own axes.

    Attributes:
        eye: (3,), where the camera is, m.
        turn: (3, 3), row k the shape's axis k in the camera's axes.
        size: (3,), MuJoCo's geom_size, m.
        light: (3,), unit vector to the light.
    """

    eye: NDArray[np.float64]
    turn: NDArray[np.float64]
    size: NDArray[np.float64]
    light: NDArray[np.float64]

    def along(self, view: View, vector: ArrayLike) -> Image:
        """Return the product (H, W) of every ray with a vector (3,) in the shape's axes."""
        return view.along((np.asarray(vector)[:, None] * self.turn).sum(axis=0))

    def dot(self, vector: NDArray[np.float64]) -> np.float32:
        """Return the product of the camera's position with a vector (3,)."""
        return np.float32((self.eye * vector).sum())


def _plane(view: View, shape: Placed) -> tuple[Image, Image]:
    """Meet an unbounded plane, from the side its z axis points to."""
    falling = -view.along(shape.turn[2])
    depth = np.where(falling > 0.0, np.float32(shape.eye[2]) / falling, np.float32(np.nan))
    return depth, np.full((1, 1), shape.light[2], dtype=np.float32)


def _box(view: View, shape: Placed) -> tuple[Image, Image]:
    """Meet a box: a ray is inside from the last of the three slabs it enters to the first that it leaves."""
    depth, leave, cosine = (np.full((1, 1), value, dtype=np.float32) for value in (-np.inf, np.inf, 0.0))
    for axis in range(3):
        rate = 1.0 / view.along(shape.turn[axis])
        middle, half = np.float32(-shape.eye[axis]) * rate, np.abs(np.float32(shape.size[axis]) * rate)
        enter = middle - half
        # A slab is entered by the face on the camera's side.
        facing = np.float32(shape.light[axis] * np.sign(shape.eye[axis]))
        cosine = np.where(enter > depth, facing, cosine)
        depth, leave = np.fmax(depth, enter), np.fmin(leave, middle + half)
    return np.where(depth <= leave, depth, np.float32(np.nan)), cosine


def _sphere(view: View, shape: Placed) -> tuple[Image, Image]:
    """Meet a sphere: the smaller root of |eye + t ray|^2 = r^2."""
    radius, square = np.float32(shape.size[0]), view.square()
    toward = shape.along(view, shape.eye)
    root = toward * toward - square * (shape.dot(shape.eye) - radius * radius)
    depth = (-toward - np.sqrt(root)) / square
    return depth, (shape.dot(shape.light) + depth * shape.along(view, shape.light)) / radius


def _capsule(view: View, shape: Placed) -> tuple[Image, Image]:
    """Meet a capsule along z: its side where the ray meets that between the ends, else the nearer end's sphere."""
    radius, half = np.float32(shape.size[0]), np.float32(shape.size[1])
    height, rise = np.float32(shape.eye[2]), view.along(shape.turn[2])
    toward, square = shape.along(view, shape.eye), view.square()
    beyond = np.float32((shape.eye[:2] ** 2).sum() - shape.size[0] ** 2)
    a, b = square - rise * rise, toward - height * rise
    side = (-b - np.sqrt(b * b - a * beyond)) / a
    at = height + side * rise
    end = np.clip(at, -half, half)
    b = toward - end * rise
    c = beyond + (height - end) ** 2
    depth = np.where(end == at, side, (-b - np.sqrt(b * b - square * c)) / square)
    nearest = np.clip(height + depth * rise, -half, half)
    lit = shape.dot(shape.light) + depth * shape.along(view, shape.light) - nearest * np.float32(shape.light[2])
    return depth, lit / radius


def _cylinder(view: View, shape: Placed) -> tuple[Image, Image]:
    """Meet a cylinder along z: the lid on the camera's side, else the side between the lids."""
    radius, half = np.float32(shape.size[0]), np.float32(shape.size[1])
    height, rise = np.float32(shape.eye[2]), view.along(shape.turn[2])
    toward, square = shape.along(view, shape.eye), view.square()
    beyond = np.float32((shape.eye[:2] ** 2).sum() - shape.size[0] ** 2)
    a, b = square - rise * rise, toward - height * rise
    side = (-b - np.sqrt(b * b - a * beyond)) / a
    at = height + side * rise
    up = np.float32(np.sign(shape.eye[2]))
    lid = (up * half - height) / rise
    on_lid = (np.abs(height) > half) & ((a * lid + 2 * b) * lid + beyond <= 0.0)
    depth = np.where(on_lid, lid, np.where(np.abs(at) <= half, side, np.float32(np.nan)))
    lit = shape.dot(shape.light) + depth * shape.along(view, shape.light) - at * np.float32(shape.light[2])
    return depth, np.where(on_lid, up * np.float32(shape.light[2]), lit / radius)


MEETINGS: dict[int, Callable[[View, Placed], tuple[Image, Image]]] = {
    int(mujoco.mjtGeom.mjGEOM_PLANE): _plane,
    int(mujoco.mjtGeom.mjGEOM_SPHERE): _sphere,
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): _capsule,
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): _cylinder,
    int(mujoco.mjtGeom.mjGEOM_BOX): _box,
}
"""For each type of geom, where rays enter it and how it is lit there.

The depth, m, is NaN for rays that miss and negative behind the camera; the other image is the cosine of the angle
between surface and light. Both are (H, W) float32, or of a shape that broadcasts to it. The camera must be outside.
"""
