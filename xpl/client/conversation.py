"""What an environment says to a policy server: the operations of the contract, for servers of any generation."""

from __future__ import annotations

from collections.abc import Coroutine, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Callable, ClassVar

from xpl import _spec as spec
from xpl.client.errors import ClientError, NoOperationError
from xpl.observation import env_indices

if TYPE_CHECKING:
    from xpl.client.exchange import Exchange
    from xpl.client.labels import Labels

_ACTING = (spec.Method.GET_ACTION, spec.Method.GET_ACTION_BATCH)


class Conversation:
    """The operations of the contract over an exchange of requests.

    Args:
        exchange: the connection.
        labels: what the trial is called.
    """

    def __init__(self, exchange: Exchange, labels: Labels) -> None:
        self._exchange = exchange
        self._labels = labels
        self._held: list[Mapping[str, Any]] = []

    # -- the operations of the contract --------------------------------------------------------------------------------

    async def reset(self, meta: Mapping[str, Any] | None = None) -> Any:
        """Start a new episode; what is told besides reaches the server, and no adapter."""
        self._held = []
        self._exchange.begin_episode()
        payload = {spec.Payload.TRIAL_ID: self._labels.trial_id, **(meta or {})}
        return (await self._exchange.request(spec.Message.RESET, payload)).get(spec.Payload.RESULT)

    async def update_obs(self, obs: Mapping[str, Any]) -> None:
        """Show the policy the newest observation of one environment."""
        self._held = [obs]
        if not self._exchange.is_first_generation:
            await self._update(spec.Method.UPDATE_OBS, obs)

    async def update_obs_batch(self, obs_list: Sequence[Mapping[str, Any]]) -> None:
        """Show the policy the newest observation of several environments."""
        self._held = list(obs_list)
        if not self._exchange.is_first_generation:
            await self._update(spec.Method.UPDATE_OBS_BATCH, list(obs_list))

    async def get_action(self, obs: Mapping[str, Any] | None = None) -> Any:
        """Return an action chunk, for `obs` if it is given and for the last observation otherwise."""
        if obs is not None:
            return await self.infer(obs)
        if self._exchange.is_first_generation:
            if len(self._held) != 1:
                raise ClientError("get_action needs exactly one observation since the last reset")
            return await self.infer(self._held[0])
        return await self._call(spec.Method.GET_ACTION)

    async def get_action_batch(self, env_idx_list: Sequence[int] | None = None) -> Any:
        """Return one action chunk per environment of the list; None means the last batch."""
        if not self._exchange.is_first_generation:
            return await self._call(spec.Method.GET_ACTION_BATCH, None if env_idx_list is None else list(env_idx_list))
        held = dict(zip(env_indices(self._held), self._held))
        wanted = list(held) if env_idx_list is None else list(env_idx_list)
        missing = [index for index in wanted if index not in held]
        if missing or len(set(wanted)) != len(wanted):
            raise ClientError(f"expected environments out of {list(held)}, each once; got {wanted}")
        # Each infer stands alone there, so an index that followed from the position in the batch has to be written.
        return [await self.infer({**held[index], spec.Obs.ENV_IDX: index}) for index in wanted]

    async def infer(self, obs: Mapping[str, Any]) -> Any:
        """Return the action chunk for one observation: update_obs and get_action as one unit."""
        answer = await self._exchange.request(spec.Message.INFER, {spec.Payload.OBSERVATION: obs})
        if spec.Payload.ACTIONS not in answer:
            raise ClientError(
                f"the server's answer to infer has no {spec.Payload.ACTIONS!r}; it has {', '.join(answer)}"
            )
        self._exchange.step += 1
        return answer[spec.Payload.ACTIONS]

    # -- the other requests --------------------------------------------------------------------------------------------

    async def prepare_case(self, action_case_id: str, meta: Mapping[str, Any]) -> Any:
        """Announce a case to the adapter's hook; what follows is about this case."""
        self._labels.action_case_id = action_case_id
        payload = {spec.Payload.ACTION_CASE_ID: action_case_id, **meta}
        return (await self._exchange.request(spec.Message.PREPARE_CASE, payload)).get(spec.Payload.RESULT)

    async def trial_end(self, result: Mapping[str, Any] | None) -> Any:
        """Tell the adapter's hook how the trial ended."""
        payload = {spec.Payload.TRIAL_ID: self._labels.trial_id, **(result or {})}
        return (await self._exchange.request(spec.Message.TRIAL_END, payload)).get(spec.Payload.RESULT)

    async def health(self) -> dict[str, Any]:
        """Return the server's state; answered while the model loads or thinks, too."""
        return await self._exchange.request(spec.Message.HEARTBEAT, {})

    async def call(self, func_name: str | None, obs: Any = None) -> Any:
        """Call an operation by name, as benchmarks do; further names are methods the adapter declares.

        Raises:
            NoOperationError: the name is none of an operation that anybody may call.
            ValueError, TypeError: prepare_case without a case, or something else than a map for what takes one.
        """
        if not isinstance(func_name, str) or not func_name or func_name.startswith("_"):
            raise NoOperationError(f"call takes the name of an operation of the policy, got {func_name!r:.80}")
        operation = self._operations.get(func_name)
        if operation is not None:
            return await operation(self, obs)
        if self._exchange.is_first_generation:
            raise ClientError(f"this server offers no {func_name!r}: it is of the first generation, without `call`")
        return await self._call(func_name, obs)

    async def _prepare(self, obs: Any) -> Any:
        about = dict(_map(spec.Message.PREPARE_CASE, obs))
        case = about.pop(spec.Payload.ACTION_CASE_ID, self._labels.action_case_id)
        if case is None:
            raise ValueError("prepare_case needs a case: make the client with action_case_id, or set it")
        return await self.prepare_case(case, about)

    _operations: ClassVar[Mapping[str, Callable[[Conversation, Any], Coroutine[Any, Any, Any]]]] = {
        spec.Method.RESET: lambda self, obs: self.reset(_map(spec.Method.RESET, obs)),
        spec.Method.UPDATE_OBS: lambda self, obs: self.update_obs(obs),
        spec.Method.UPDATE_OBS_BATCH: lambda self, obs: self.update_obs_batch(obs),
        spec.Method.GET_ACTION: lambda self, obs: self.get_action(obs),
        spec.Method.GET_ACTION_BATCH: lambda self, obs: self.get_action_batch(obs),
        spec.Message.INFER: lambda self, obs: self.infer(obs),
        spec.Message.PREPARE_CASE: _prepare,
        spec.Message.TRIAL_END: lambda self, obs: self.trial_end(_map(spec.Message.TRIAL_END, obs)),
        spec.Message.HEARTBEAT: lambda self, _: self.health(),
    }

    async def _update(self, name: str, obs: Any) -> None:
        if self._exchange.goes_ahead:
            await self._exchange.send_ahead({spec.Payload.FUNC_NAME: name, spec.Payload.OBS: obs})
        else:
            await self._call(name, obs)

    async def _call(self, name: str, obs: Any = None) -> Any:
        payload = {spec.Payload.FUNC_NAME: name}
        if obs is not None:
            payload[spec.Payload.OBS] = obs
        result = (await self._exchange.request(spec.Message.CALL, payload)).get(spec.Payload.RESULT)
        self._exchange.step += name in _ACTING
        return result


def _map(operation: str, obs: Any) -> Mapping[str, Any]:
    """Return what is told with an operation that takes a map or nothing.

    Raises:
        TypeError: it is something else, which would be lost.
    """
    if obs is not None and not isinstance(obs, Mapping):
        raise TypeError(f"{operation} takes a map or None, got {type(obs).__name__}")
    return obs or {}
