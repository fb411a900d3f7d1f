"""The backends by their names, and how many lanes and servers each takes."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from xpl_cli.basics.errors import UserError
from xpl_cli.evaluation.lanes.backend import NAMES, RAY

if TYPE_CHECKING:
    from xpl_cli.evaluation.lanes.backend import Backend, Room
    from xpl_cli.evaluation.lanes.orders import Orders
    from xpl_cli.evaluation.lanes.servers import ServerOrders


def lanes_of(workers: str) -> int | None:
    """Return the number of lanes that `--workers` asks for; None for `auto`.

    Raises:
        UserError: it is neither a number above 0 nor `auto`.
    """
    if workers == "auto":
        return None
    if not workers.isdecimal() or len(workers) > 6 or not int(workers):
        raise UserError(f"--workers of a recorded run must be a number from 1 to 999999, or auto, got {workers!r}")
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
    from xpl_cli.evaluation.lanes.local import LocalBackend, shared

    lanes = min(room.lanes or len(os.sched_getaffinity(0)), max(1, episodes))
    # A model on a GPU takes room there: it is loaded once, unless somebody says otherwise.
    servers = room.servers or (lanes if server_orders.gpu is None else 1)
    return LocalBackend(orders, shared(server_orders, lanes, min(servers, lanes)))
