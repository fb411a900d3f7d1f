"""A conversation in frames of xpl's own wire, with servers of any generation.

Against one of the first, which knows no `call`, observations are held back and sent with `infer`, and a batch is one
infer per environment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl.client.conversation import Conversation
from xpl.client.errors import ClientError
from xpl.client.exchange import Exchange
from xpl.client.wires import Wire
from xpl.observation import env_indices

if TYPE_CHECKING:
    from xpl.client.transport import Setup
    from xpl.contract import Announcement, Observation, Payload

_ACTING = (spec.Method.GET_ACTION, spec.Method.GET_ACTION_BATCH)


class FramedConversation(Conversation):
    """The operations of the contract over an exchange of requests."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._exchange = Exchange(setup.transport(), setup.address, setup.config, setup.wishes, setup.labels)
        self._held: list[Observation] = []

    @property
    def server_instance_id(self) -> str | None:  # type: ignore[override]
        """What the server calls itself; None for one of the first generation."""
        return self._exchange.server_instance_id

    @property
    def capabilities(self) -> Mapping[str, Any]:  # type: ignore[override]
        """What the server announced that it can do."""
        return self._exchange.capabilities

    @property
    def policy(self) -> Announcement:  # type: ignore[override]
        """What the policy needs, where the server said so."""
        return self._exchange.policy

    async def connect(self) -> None:
        """Connect and exchange hellos."""
        await self._exchange.connect()

    async def close(self) -> None:
        """Say goodbye and close the connection; closing twice is fine."""
        await self._exchange.close()

    async def settle(self) -> None:
        """Wait until every update that was sent ahead is answered, and raise what went wrong with one."""
        await self._exchange.settle()

    # -- the operations of the contract --------------------------------------------------------------------------------

    async def reset(self, meta: Mapping[str, Any] | None = None) -> Any:
        """Start a new episode; what is told besides reaches the server, and no adapter."""
        self._held = []
        self._exchange.begin_episode()
        payload = {spec.Payload.TRIAL_ID: self._labels.trial_id, **(meta or {})}
        return (await self._exchange.request(spec.Message.RESET, payload)).get(spec.Payload.RESULT)

    async def update_obs(self, obs: Observation) -> None:
        """Show the policy the newest observation of one environment."""
        self._held = [obs]
        if not self._exchange.is_first_generation:
            await self._update(spec.Method.UPDATE_OBS, obs)

    async def update_obs_batch(self, obs_list: Sequence[Observation]) -> None:
        """Show the policy the newest observation of several environments."""
        self._held = list(obs_list)
        if not self._exchange.is_first_generation:
            await self._update(spec.Method.UPDATE_OBS_BATCH, list(obs_list))

    async def get_action(self, obs: Observation | None = None) -> Any:
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

    async def infer(self, obs: Observation) -> Any:
        """Return the action chunk for one observation: update_obs and get_action as one unit."""
        answer = await self._exchange.request(spec.Message.INFER, {spec.Payload.OBSERVATION: obs})
        if spec.Payload.ACTIONS not in answer:
            raise ClientError(
                f"the server's answer to infer has no {spec.Payload.ACTIONS!r}; it has {', '.join(answer):.400}"
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

    async def health(self) -> Payload:
        """Return the server's state; answered while the model loads or thinks, too."""
        return await self._exchange.request(spec.Message.HEARTBEAT, {})

    async def call_method(self, name: str, obs: Any = None) -> Any:
        """Call a method that the adapter declares besides the contract."""
        if self._exchange.is_first_generation:
            raise ClientError(f"this server offers no {name!r}: it is of the first generation, without `call`")
        return await self._call(name, obs)

    async def _update(self, name: str, obs: object) -> None:
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


WIRE = Wire(conversation=FramedConversation)
