"""The backends by their names, and how many lanes and servers each takes."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from xpl_cli.evaluation.lanes.backend import Backend
    from xpl_cli.evaluation.lanes.lane import Orders
    from xpl_cli.evaluation.lanes.servers import ServerOrders

LOCAL, RAY = "local", "ray"
NAMES = (LOCAL, RAY)


@dataclass(frozen=True)
class Room:
    """Where a run is played, and how much of it at a time.

    Attributes:
        backend: one of `NAMES`.
        lanes: episodes at a time; None is as many as there are cores.
        servers: policy servers that the lanes share; None leaves it to the backend.
        gpus: of the cluster, for each policy server.
    """

    backend: str = LOCAL
    lanes: int | None = 1
    servers: int | None = None
    gpus: float = 0.0


def lanes_of(workers: str) -> int | None:
    """Return the number of lanes that `--workers` asks for; None for `auto`.

    Raises:
        UserError: it is neither a number above 0 nor `auto`.
    """
    if workers == "auto":
        return None
    if not workers.isdecimal() or not int(workers):
        raise UserError(f"--workers of a recorded run must be a number above 0, or auto, got {workers!r}")
    return int(workers)


def check(room: Room) -> None:
    """Raise a UserError for a backend that there is not."""
    if room.backend not in NAMES:
        raise UserError(f"there is no backend {room.backend!r}; there are: {', '.join(NAMES)}")


def make(room: Room, orders: Orders, server_orders: ServerOrders, episodes: int) -> Backend:
    """Return the backend of a run.

    Args:
        room: where, and how much at a time.
        orders: what lanes play.
        server_orders: how the policy is served.
        episodes: how many are to be played; more lanes than that are no use.

    Raises:
        UserError: it cannot be had here.
    """
    if room.backend == RAY:
        from xpl_cli.evaluation.lanes.ray_backend import RayBackend

        return RayBackend(orders, server_orders, room, episodes)
    from xpl_cli.evaluation.lanes.local import LocalBackend

    lanes = min(room.lanes or len(os.sched_getaffinity(0)), max(1, episodes))
    # A model on a GPU takes room there: it is loaded once, unless somebody says otherwise.
    servers = room.servers or (lanes if server_orders.gpu is None else 1)
    return LocalBackend(orders, server_orders, lanes, min(servers, lanes))
