"""Conversation in frames of xpl's own wire, with servers of any generation.

A server of the first generation has no `call`: the client buffers observations and sends them with `infer`, one per
environment of a batch.
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
    from xpl.client.transport import ConversationSetup
    from xpl.contract import Announcement, Observation, Payload

_ACTING = (spec.Method.GET_ACTION, spec.Method.GET_ACTION_BATCH)


class FramedConversation(Conversation):
    """The operations of the contract over an exchange of requests."""

    def __init__(self, setup: ConversationSetup) -> None:
        super().__init__(setup)
        self._exchange = Exchange(setup.transport(), setup.address, setup.config, setup.options, setup.labels)
        self._buffered: list[Observation] = []

    @property
    def server_instance_id(self) -> str | None:  # type: ignore[override]
        """Id of the server instance; None for a server of the first generation."""
        return self._exchange.server_instance_id

    @property
    def capabilities(self) -> Mapping[str, Any]:  # type: ignore[override]
        """Capabilities that the server announced."""
        return self._exchange.capabilities

    @property
    def policy(self) -> Announcement:  # type: ignore[override]
        """What the policy needs, as the server announced it; empty where it did not."""
        return self._exchange.policy

    async def connect(self) -> None:
        """Connect and exchange hellos."""
        await self._exchange.connect()

    async def close(self) -> None:
        """Send a close message and close the connection; closing twice is fine."""
        await self._exchange.close()

    async def settle(self) -> None:
        """Wait for the answers to all pipelined updates, and raise the error of one that failed."""
        await self._exchange.settle()

    # -- the operations of the contract --------------------------------------------------------------------------------

    async def reset(self, meta: Mapping[str, Any] | None = None) -> Any:
        """Start a new episode; `meta` reaches the server, not the adapter."""
        self._buffered = []
        self._exchange.begin_episode()
        payload = {spec.Payload.TRIAL_ID: self._labels.trial_id, **(meta or {})}
        return (await self._exchange.request(spec.Message.RESET, payload)).get(spec.Payload.RESULT)

    async def send_observation(self, obs: Observation) -> None:
        """Send the newest observation of one environment to the policy."""
        self._buffered = [obs]
        if not self._exchange.is_first_generation:
            await self._send_update(spec.Method.UPDATE_OBS, obs)

    async def send_observations(self, obs_list: Sequence[Observation]) -> None:
        """Send the newest observations of several environments to the policy."""
        self._buffered = list(obs_list)
        if not self._exchange.is_first_generation:
            await self._send_update(spec.Method.UPDATE_OBS_BATCH, list(obs_list))

    async def request_action(self, obs: Observation | None = None) -> Any:
        """Return an action chunk, for `obs` if it is passed and for the last observation otherwise."""
        if obs is not None:
            return await self.infer(obs)
        if self._exchange.is_first_generation:
            if len(self._buffered) != 1:
                raise ClientError("get_action needs exactly one observation since the last reset")
            return await self.infer(self._buffered[0])
        return await self._call(spec.Method.GET_ACTION)

    async def request_actions(self, env_idx_list: Sequence[int] | None = None) -> Any:
        """Return one action chunk per environment of the list; None means the environments of the last batch."""
        if not self._exchange.is_first_generation:
            return await self._call(spec.Method.GET_ACTION_BATCH, None if env_idx_list is None else list(env_idx_list))
        buffered = dict(zip(env_indices(self._buffered), self._buffered))
        requested = list(buffered) if env_idx_list is None else list(env_idx_list)
        missing = [index for index in requested if index not in buffered]
        if missing or len(set(requested)) != len(requested):
            raise ClientError(f"expected environments out of {list(buffered)}, each once; got {requested}")
        # Each infer is a request by itself: an index that followed from the position in the batch is written out.
        return [await self.infer({**buffered[index], spec.Obs.ENV_IDX: index}) for index in requested]

    async def infer(self, obs: Observation) -> Any:
        """Return the action chunk for one observation: update_obs and get_action in one request."""
        answer = await self._exchange.request(spec.Message.INFER, {spec.Payload.OBSERVATION: obs})
        if spec.Payload.ACTIONS not in answer:
            raise ClientError(
                f"the server's answer to infer has no {spec.Payload.ACTIONS!r}; it has {', '.join(answer):.400}"
            )
        self._exchange.step += 1
        return answer[spec.Payload.ACTIONS]

    # -- the other requests --------------------------------------------------------------------------------------------

    async def prepare_case(self, action_case_id: str, meta: Mapping[str, Any]) -> Any:
        """Call the adapter's hook prepare_case; later requests belong to this case."""
        self._labels.action_case_id = action_case_id
        payload = {spec.Payload.ACTION_CASE_ID: action_case_id, **meta}
        return (await self._exchange.request(spec.Message.PREPARE_CASE, payload)).get(spec.Payload.RESULT)

    async def trial_end(self, result: Mapping[str, Any] | None) -> Any:
        """Call the adapter's hook trial_end with the result of the trial."""
        payload = {spec.Payload.TRIAL_ID: self._labels.trial_id, **(result or {})}
        return (await self._exchange.request(spec.Message.TRIAL_END, payload)).get(spec.Payload.RESULT)

    async def health(self) -> Payload:
        """Return the server's state; answered while the model loads and during inference, too."""
        return await self._exchange.request(spec.Message.HEARTBEAT, {})

    async def call_method(self, name: str, obs: Any = None) -> Any:
        """Call a method that the adapter declares besides the contract."""
        if self._exchange.is_first_generation:
            raise ClientError(f"this server offers no {name!r}: it is of the first generation, without `call`")
        return await self._call(name, obs)

    async def _send_update(self, name: str, obs: object) -> None:
        if self._exchange.is_pipelined:
            await self._exchange.send_pipelined({spec.Payload.FUNC_NAME: name, spec.Payload.OBS: obs})
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
