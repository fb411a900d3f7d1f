"""Environment numbers of several clients that share a model, and the episode that each client is in.

Client k calls its environments 0, 1, ...; the model knows them as k * client_envs + 0, ... (`limits.client_envs` of
spec/v1/wire.yml). A client that has a model to itself is client 0.
"""

from __future__ import annotations

from collections.abc import Iterable

from xpl import _spec as spec

CLIENT_ENVS: int = spec.LIMITS["client_envs"]
"""Environments that one client may have."""


def shared_index(client: int, env: int) -> int:
    """Return the number by which a shared model knows environment `env` of a client."""
    return client * CLIENT_ENVS + env


def own_index(env: int) -> int:
    """Return what its client calls an environment of a shared model."""
    return env % CLIENT_ENVS


class EpisodeCounter:
    """Counts episodes by client: a reset ends one in which something was observed, and no other."""

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}
        self._observed: set[int] = set()

    def observe(self, envs: Iterable[int]) -> None:
        """Note that environments were observed."""
        self._observed.update(env // CLIENT_ENVS for env in envs)

    def reset(self, envs: Iterable[int]) -> None:
        """End the episode of the clients of these environments; one that resets twice keeps its seeds."""
        ended = {env // CLIENT_ENVS for env in envs} & self._observed
        for client in ended:
            self._counts[client] = self._counts.get(client, 0) + 1
        self._observed -= ended

    def seeds(self, seed: int, env: int) -> list[int]:
        """Return the entropy of an environment's generator: run seed, episode, and its index among its client's."""
        return [seed % 2**63, self._counts.get(env // CLIENT_ENVS, 0), own_index(env)]
