"""The backends by their names, and how many lanes and servers each takes."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from xpl_cli.basics.errors import UserError
from xpl_cli.evaluation.rollout.backend import NAMES, RAY

if TYPE_CHECKING:
    from xpl_cli.evaluation.rollout.backend import Backend, BackendConfig
    from xpl_cli.evaluation.rollout.config import RolloutConfig
    from xpl_cli.evaluation.rollout.servers import ServerConfig


def parse_workers(workers: str) -> int | None:
    """Return the number of lanes that `--workers` asks for; None for `auto`.

    Raises:
        UserError: it is neither a number above 0 nor `auto`.
    """
    if workers == "auto":
        return None
    if not workers.isdecimal() or len(workers) > 6 or not int(workers):
        raise UserError(f"--workers of a recorded run must be a number from 1 to 999999, or auto, got {workers!r}")
    return int(workers)


def check_backend(room: BackendConfig) -> None:
    """Raise a UserError for a backend that there is not."""
    if room.backend not in NAMES:
        raise UserError(f"there is no backend {room.backend!r}; there are: {', '.join(NAMES)}")


def make_backend(room: BackendConfig, config: RolloutConfig, server_config: ServerConfig, episodes: int) -> Backend:
    """Return the backend of a run.

    Args:
        room: where, and how much at a time.
        config: what lanes play.
        server_config: how the policy is served.
        episodes: how many are to be played; more lanes than that are no use.

    Raises:
        UserError: it cannot be had here.
    """
    if room.backend == RAY:
        from xpl_cli.evaluation.rollout.ray_backend import RayBackend

        return RayBackend(config, server_config, room, episodes)
    from xpl_cli.evaluation.rollout.local_backend import LocalBackend, assign_servers

    workers = min(room.lanes or len(os.sched_getaffinity(0)), max(1, episodes))
    # A model on a GPU takes room there: it is loaded once, unless somebody says otherwise.
    servers = room.servers or (workers if server_config.gpu is None else 1)
    return LocalBackend(config, assign_servers(server_config, workers, min(servers, workers)))
