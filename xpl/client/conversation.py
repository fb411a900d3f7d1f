"""The client's side of a wire: the operations of the contract; a wire may support fewer."""

from __future__ import annotations

from collections.abc import Coroutine, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Callable, ClassVar

from xpl import _spec as spec
from xpl.client.errors import NoOperationError

if TYPE_CHECKING:
    from xpl.client.transport import ConversationSetup
    from xpl.contract import Observation, Payload


class Conversation:
    """Base of the client protocols. Written with `async`; over a blocking transport (`xpl.Client`) never suspended.

    Args:
        setup: address, configuration, labels, options, and a factory of transports.

    Attributes:
        server_instance_id: id of the server instance, None where the wire has none.
        capabilities: what the server announced.
        policy: what its policy needs (`xpl.client.agreement`); empty where it announced nothing.
        metadata: the server's greeting, where the wire has one.
    """

    server_instance_id: str | None = None
    capabilities: Mapping[str, Any] = {}
    policy: Mapping[str, Any] = {}
    metadata: Mapping[str, Any] = {}

    def __init__(self, setup: ConversationSetup) -> None:
        self._setup = setup
        self._labels = setup.labels

    async def connect(self) -> None:
        """Connect, and try again while no server listens."""
        raise NotImplementedError

    async def close(self) -> None:
        """Close all connections; closing twice is fine."""
        raise NotImplementedError

    # -- the operations of the contract --------------------------------------------------------------------------------

    async def reset(self, meta: Mapping[str, Any] | None = None) -> Any:
        """Start a new episode; `meta` reaches the server, not the adapter."""
        raise NotImplementedError

    async def send_observation(self, obs: Observation) -> None:
        """Send the newest observation of one environment to the policy."""
        raise NotImplementedError

    async def send_observations(self, obs_list: Sequence[Observation]) -> None:
        """Send the newest observations of several environments to the policy."""
        raise NotImplementedError

    async def request_action(self, obs: Observation | None = None) -> Any:
        """Return an action chunk, for `obs` if it is passed and for the last observation otherwise."""
        raise NotImplementedError

    async def request_actions(self, env_idx_list: Sequence[int] | None = None) -> Any:
        """Return one action chunk per environment of the list; None means the environments of the last batch."""
        raise NotImplementedError

    async def infer(self, obs: Observation) -> Any:
        """Return the action chunk for one observation: update_obs and get_action in one request."""
        return await self.request_action(obs)

    # -- the other requests --------------------------------------------------------------------------------------------

    async def prepare_case(self, action_case_id: str, meta: Mapping[str, Any]) -> Any:
        """Call the adapter's hook prepare_case; later requests belong to this case."""
        del action_case_id, meta
        raise self._unsupported(spec.Message.PREPARE_CASE)

    async def trial_end(self, result: Mapping[str, Any] | None) -> Any:
        """Call the adapter's hook trial_end with the result of the trial."""
        del result
        raise self._unsupported(spec.Message.TRIAL_END)

    async def health(self) -> Payload:
        """Return the server's state; answered while the model loads and during inference, too."""
        raise self._unsupported(spec.Message.HEARTBEAT)

    async def settle(self) -> None:
        """Wait for the answers to all pipelined updates."""

    async def call_method(self, name: str, obs: Any = None) -> Any:
        """Call a method that the adapter declares besides the contract."""
        del obs
        raise self._unsupported(name)

    async def call(self, func_name: str | None, obs: Any = None) -> Any:
        """Call an operation by name, as benchmarks do; other names are methods that the adapter declares.

        Raises:
            NoOperationError: no client may call this name, or this wire has no such operation.
            ValueError: prepare_case without a case.
            TypeError: the operation takes a map or None, and got something else.
        """
        if not isinstance(func_name, str) or not func_name or func_name.startswith("_"):
            raise NoOperationError(f"call takes the name of an operation of the policy, got {func_name!r:.80}")
        operation = self._operations.get(func_name)
        return await (self.call_method(func_name, obs) if operation is None else operation(self, obs))

    async def _prepare(self, obs: object) -> Any:
        about = dict(_map(spec.Message.PREPARE_CASE, obs))
        case = about.pop(spec.Payload.ACTION_CASE_ID, self._labels.action_case_id)
        if case is None:
            raise ValueError("prepare_case needs a case: make the client with action_case_id, or set it")
        return await self.prepare_case(case, about)

    _operations: ClassVar[Mapping[str, Callable[[Conversation, Any], Coroutine[Any, Any, Any]]]] = {
        spec.Method.RESET: lambda self, obs: self.reset(_map(spec.Method.RESET, obs)),
        spec.Method.UPDATE_OBS: lambda self, obs: self.send_observation(obs),
        spec.Method.UPDATE_OBS_BATCH: lambda self, obs: self.send_observations(obs),
        spec.Method.GET_ACTION: lambda self, obs: self.request_action(obs),
        spec.Method.GET_ACTION_BATCH: lambda self, obs: self.request_actions(obs),
        spec.Message.INFER: lambda self, obs: self.infer(obs),
        spec.Message.PREPARE_CASE: _prepare,
        spec.Message.TRIAL_END: lambda self, obs: self.trial_end(_map(spec.Message.TRIAL_END, obs)),
        spec.Message.HEARTBEAT: lambda self, _: self.health(),
    }

    def _unsupported(self, name: str) -> NoOperationError:
        return NoOperationError(f"the wire {self._setup.wire} has no {name}")


def _map(operation: str, obs: object) -> Mapping[str, Any]:
    """Return the argument of an operation that takes a map or None.

    Raises:
        TypeError: it is something else.
    """
    if obs is not None and not isinstance(obs, Mapping):
        raise TypeError(f"{operation} takes a map or None, got {type(obs).__name__}")
    return obs or {}
