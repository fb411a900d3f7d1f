"""Room and table as cameras see them: planes and boxes, intersected in closed form for all pixels at once.

They fill most of every image. Casting those rays through `mj_multiRay` costs several times more, because it pays for
each ray and each body.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Surface:
    """One plane of a single normal: a wall, the floor, or a face of a box.

    Attributes:
        geom: id of the geom it belongs to.
        normal: (3,) unit normal towards the viewer.
        offset: distance of the plane from the origin along the normal, m.
    """

    geom: int
    normal: NDArray[np.float64]
    offset: float


class Backdrop:
    """The geoms of one group, which must be unbounded planes around the viewer and boxes; none of them moves.

    Args:
        model: `mujoco.MjModel`.
        data: `mujoco.MjData` with up-to-date kinematics.
        group: geom group.
    """

    def __init__(self, model: Any, data: Any, group: int) -> None:
        self._planes: list[Surface] = []
        self._boxes: list[list[tuple[Surface, Surface]]] = []
        for geom in np.flatnonzero(model.geom_group == group).tolist():
            frame, center = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
                self._planes.append(_surface(geom, frame[:, 2], center))
            elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
                arms = (frame * model.geom_size[geom]).T
                self._boxes.append(
                    [
                        (_surface(geom, axis, center + arm), _surface(geom, -axis, center - arm))
                        for axis, arm in zip(frame.T, arms, strict=True)
                    ]
                )
            else:
                raise ValueError(f"geom {model.geom(geom).name!r} of the backdrop must be a plane or a box")
        self.surfaces = [*self._planes, *(face for box in self._boxes for pair in box for face in pair)]

    def cast(
        self, origin: NDArray[np.float64], directions: NDArray[np.float32]
    ) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Intersect rays from one point, outside the boxes and in front of the planes.

        Args:
            origin: (3,), m.
            directions: (3, N) unit vectors, one row per axis.

        Returns:
            index (N,) into `surfaces` of the nearest surface, -1 for none, and distance (N,), m, infinite for none.
        """
        count = directions.shape[1]
        nearest = np.full(count, np.inf, dtype=np.float32)
        index = np.full(count, -1, dtype=np.int32)
        with np.errstate(divide="ignore", invalid="ignore"):
            for number, plane in enumerate(self._planes):
                distance, speed = _approach(plane, origin, directions)
                closer = (speed < 0) & (distance < nearest)
                nearest[closer], index[closer] = distance[closer], number
            number = len(self._planes)
            for box in self._boxes:
                distance, face = _enter(box, origin, directions)
                closer = distance < nearest
                nearest[closer], index[closer] = distance[closer], number + face[closer]
                number += 6
        return index, nearest


def _surface(geom: int, normal: NDArray[np.float64], point: NDArray[np.float64]) -> Surface:
    return Surface(geom=geom, normal=np.array(normal), offset=float(np.sum(normal * point)))


def _approach(
    plane: Surface, origin: NDArray[np.float64], directions: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the distance to a plane along each ray and the rate at which the ray leaves it."""
    speed = np.zeros(directions.shape[1], dtype=np.float32)
    for component, row in zip(plane.normal.astype(np.float32), directions, strict=True):
        if component:
            speed += component * row
    height = np.float32(float(np.sum(plane.normal * origin)) - plane.offset)
    return -height / speed, speed


def _enter(
    box: list[tuple[Surface, Surface]], origin: NDArray[np.float64], directions: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return where each ray enters a convex box (infinite: it does not) and by which of its six faces."""
    count = directions.shape[1]
    entry = np.zeros(count, dtype=np.float32)
    leave = np.full(count, np.inf, dtype=np.float32)
    face = np.zeros(count, dtype=np.int32)
    for axis, (front, back) in enumerate(box):
        to_front, speed = _approach(front, origin, directions)
        to_back, _ = _approach(back, origin, directions)
        facing_front = speed < 0
        near = np.where(facing_front, to_front, to_back)
        later = near > entry
        entry = np.where(later, near, entry)
        face = np.where(later, np.where(facing_front, 2 * axis, 2 * axis + 1), face).astype(np.int32)
        leave = np.fmin(leave, np.where(facing_front, to_back, to_front))
    return np.where((entry > 0) & (entry < leave), entry, np.float32(np.inf)), face
