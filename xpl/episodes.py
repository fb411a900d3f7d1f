"""Environment indices of clients that share a model, and the episode count of each client.

Environment i of client k has the index k * client_envs + i in the model (`limits.client_envs` of spec/v1/wire.yml). The
only client of a model is client 0.
"""

from __future__ import annotations

from collections.abc import Iterable

from xpl import _spec as spec

CLIENT_ENVS: int = spec.LIMITS["client_envs"]
"""Most environments of one client."""


def shared_index(client: int, env: int) -> int:
    """Return the index in a shared model of environment `env` of a client."""
    return client * CLIENT_ENVS + env


def own_index(env: int) -> int:
    """Return the client's own index of an environment of a shared model."""
    return env % CLIENT_ENVS


class EpisodeCounter:
    """Counts episodes by client: a reset ends an episode only if something was observed in it."""

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}
        self._observed: set[int] = set()

    def observe(self, envs: Iterable[int]) -> None:
        """Record that environments were observed."""
        self._observed.update(env // CLIENT_ENVS for env in envs)

    def reset(self, envs: Iterable[int]) -> None:
        """End the episode of the clients of these environments; a second reset changes nothing."""
        ended = {env // CLIENT_ENVS for env in envs} & self._observed
        for client in ended:
            self._counts[client] = self._counts.get(client, 0) + 1
        self._observed -= ended

    def seeds(self, seed: int, env: int) -> list[int]:
        """Return the entropy of an environment's generator: run seed, episode, and its index among its client's."""
        return [seed % 2**63, self._counts.get(env // CLIENT_ENVS, 0), own_index(env)]
