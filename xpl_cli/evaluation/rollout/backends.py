"""Backends by name, and their numbers of workers and servers."""

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
    """Return the number of rollout workers of `--workers`; None for `auto`.

    Raises:
        UserError: it is neither a number above 0 nor `auto`.
    """
    if workers == "auto":
        return None
    if not workers.isdecimal() or len(workers) > 6 or not int(workers):
        raise UserError(f"--workers of a recorded run must be a number from 1 to 999999, or auto, got {workers!r}")
    return int(workers)


def check_backend(backend_config: BackendConfig) -> None:
    """Raise a UserError for a backend that there is not."""
    if backend_config.backend not in NAMES:
        raise UserError(f"there is no backend {backend_config.backend!r}; there are: {', '.join(NAMES)}")


def make_backend(
    backend_config: BackendConfig, config: RolloutConfig, server_config: ServerConfig, episodes: int
) -> Backend:
    """Return the backend of a run.

    Args:
        backend_config: which backend, and how many workers.
        config: what the workers run.
        server_config: how the policy is served.
        episodes: upper limit of useful workers.

    Raises:
        UserError: the backend is not available here.
    """
    if backend_config.backend == RAY:
        from xpl_cli.evaluation.rollout.ray_backend import RayBackend

        return RayBackend(config, server_config, backend_config, episodes)
    from xpl_cli.evaluation.rollout.local_backend import LocalBackend, assign_servers

    workers = min(backend_config.workers or len(os.sched_getaffinity(0)), max(1, episodes))
    # A model on a GPU takes memory there: it is loaded once, unless the user sets --servers.
    servers = backend_config.servers or (workers if server_config.gpu is None else 1)
    return LocalBackend(config, assign_servers(server_config, workers, min(servers, workers)))
