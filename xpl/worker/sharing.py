"""One model for several clients: each has environments of its own, and those that ask at once are one batch.

An adapter allows it with `serving: {shared: true}` in policy.yml. `xpl.episodes` says by which numbers it knows their
environments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl.episodes import CLIENT_ENVS, shared_index
from xpl.observation import ObservationError, env_index, env_indices
from xpl.policy import PolicyStateError

if TYPE_CHECKING:
    from xpl.contract import Observation

_FAILURES = (BaseException,)
"""What belongs to the client whose request raised it: anything (`xpl.worker.main`)."""


@dataclass
class _Client:
    """What is remembered of one client in its episode.

    Attributes:
        first: number that the adapter knows its environment 0 by.
        order: environments of its last observations, or None before any.
        known: all its environments since the last reset.
    """

    first: int
    order: list[int] | None = None
    known: set[int] = field(default_factory=set)

    def numbers(self, envs: Sequence[Any]) -> list[int]:
        """Return the adapter's numbers of environments of this client."""
        return [self.first + env_index(env) for env in envs]


@dataclass(frozen=True)
class Request:
    """One client's operation: `infer` or one of the contract, and its argument."""

    client: int
    method: str
    argument: Any = None


class SharedModel:
    """Runs the requests of several clients on one model.

    Args:
        model: an adapter with `reset_envs(env_idx_list)` besides the batched operations.
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        self._clients: dict[int, _Client] = {}

    def run(self, requests: Sequence[Request]) -> list[Any]:
        """Return the result of each request, or the exception that it raised; at most one request of each client.

        A failure belongs to the client that caused it: if the common batch raises, every request is tried alone.
        """
        results: list[Any] = [None] * len(requests)
        asked: dict[int, list[int]] = {}
        for place, request in enumerate(requests):
            try:
                wanted = self._observe(request)
            except _FAILURES as error:  # noqa: PERF203 - each is tried alone
                results[place] = error
            else:
                if wanted is not None:
                    asked[place] = wanted
        for place, chunks in self._answers(asked).items():
            single = requests[place].method in (spec.Method.INFER, spec.Method.GET_ACTION)
            results[place] = chunks[0] if single and isinstance(chunks, list) else chunks
        return results

    def _observe(self, request: Request) -> list[int] | None:
        """Do what a request does before actions are asked for, and return the environments it asks for, if any."""
        client = self._clients.setdefault(request.client, _Client(shared_index(request.client, 0)))
        method, argument = request.method, request.argument
        if method == spec.Method.RESET:
            client.order = None
            self._model.reset_envs(sorted(client.known))
            client.known.clear()  # not before: a reset that failed is tried again for the same environments
            return None
        actions = method == spec.Method.GET_ACTION and isinstance(argument, Mapping)
        if actions or method in (spec.Method.INFER, spec.Method.UPDATE_OBS):
            index = argument.get(spec.Obs.ENV_IDX)
            self._update(client, [argument], [0 if index is None else index])
        elif method == spec.Method.UPDATE_OBS_BATCH:
            self._update(client, argument, env_indices(argument))
        if method in (spec.Method.UPDATE_OBS, spec.Method.UPDATE_OBS_BATCH):
            return None
        if method == spec.Method.GET_ACTION_BATCH and argument is not None:
            return self._checked(client, client.numbers(argument))
        if client.order is None:
            raise PolicyStateError(f"{method} needs an observation since the last reset")
        if method != spec.Method.GET_ACTION_BATCH and len(client.order) != 1:
            envs = [number - client.first for number in client.order]
            raise PolicyStateError(f"get_action answers one environment, but the last batch held {envs}")
        return client.order

    def _update(self, client: _Client, observations: Sequence[Observation], envs: Sequence[Any]) -> None:
        numbers = client.numbers(envs)
        if any(number >= client.first + CLIENT_ENVS for number in numbers):
            raise ObservationError(f"env_idx must be below {CLIENT_ENVS} where clients share a model, got {list(envs)}")
        self._model.update_obs_batch([{**obs, spec.Obs.ENV_IDX: number} for obs, number in zip(observations, numbers)])
        client.order = numbers
        client.known.update(numbers)

    def _checked(self, client: _Client, numbers: list[int]) -> list[int]:
        envs = [number - client.first for number in numbers]
        unknown = [env for env, number in zip(envs, numbers) if client.order is None or number not in client.known]
        if unknown:
            raise PolicyStateError(f"environments {unknown} have no observation since the last reset")
        if len(set(envs)) != len(envs):
            raise PolicyStateError(f"an environment is repeated in {envs}")
        return numbers

    def _answers(self, asked: Mapping[int, list[int]]) -> dict[int, Any]:
        """Return the chunks, or the exception, for each place that asked for some environments."""
        together = [number for numbers in asked.values() for number in numbers]
        try:
            chunks = list(self._model.get_action_batch(together)) if together else []
            if len(chunks) != len(together):
                raise ValueError(f"get_action_batch returned {len(chunks)} chunks for {len(together)} environments")
        except _FAILURES as error:
            if len(asked) == 1:
                return dict.fromkeys(asked, error)
            return {place: self._answers({place: numbers})[place] for place, numbers in asked.items()}
        answers, start = {}, 0
        for place, numbers in asked.items():
            answers[place] = chunks[start : start + len(numbers)]
            start += len(numbers)
        return answers
