"""The client's side of a wire: the operations of the contract, and what wires do that know fewer of them."""

from __future__ import annotations

from collections.abc import Coroutine, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Callable, ClassVar

from xpl import _spec as spec
from xpl.client.errors import NoOperationError

if TYPE_CHECKING:
    from xpl.client.transport import Setup
    from xpl.contract import Observation, Payload


class Conversation:
    """What clients hold. Written with `async`, and never suspended over a transport that blocks (`xpl.Client`).

    Args:
        setup: the address, the configuration, and how a connection is made.

    Attributes:
        server_instance_id: what the server calls itself, None where it does not.
        capabilities: what it announced that it can do.
        policy: what its policy needs, where it said so (`xpl.client.agreement`).
        metadata: what else it said of itself.
    """

    server_instance_id: str | None = None
    capabilities: Mapping[str, Any] = {}
    policy: Mapping[str, Any] = {}
    metadata: Mapping[str, Any] = {}

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._labels = setup.labels

    async def connect(self) -> None:
        """Connect, trying again while nobody listens."""
        raise NotImplementedError

    async def close(self) -> None:
        """Close all connections; closing twice is fine."""
        raise NotImplementedError

    # -- the operations of the contract --------------------------------------------------------------------------------

    async def reset(self, meta: Mapping[str, Any] | None = None) -> Any:
        """Start a new episode; what is told besides reaches the server, and no adapter."""
        raise NotImplementedError

    async def update_obs(self, obs: Observation) -> None:
        """Show the policy the newest observation of one environment."""
        raise NotImplementedError

    async def update_obs_batch(self, obs_list: Sequence[Observation]) -> None:
        """Show the policy the newest observation of several environments."""
        raise NotImplementedError

    async def get_action(self, obs: Observation | None = None) -> Any:
        """Return an action chunk, for `obs` if it is given and for the last observation otherwise."""
        raise NotImplementedError

    async def get_action_batch(self, env_idx_list: Sequence[int] | None = None) -> Any:
        """Return one action chunk per environment of the list; None means the last batch."""
        raise NotImplementedError

    async def infer(self, obs: Observation) -> Any:
        """Return the action chunk for one observation: update_obs and get_action as one unit."""
        return await self.get_action(obs)

    # -- the other requests --------------------------------------------------------------------------------------------

    async def prepare_case(self, action_case_id: str, meta: Mapping[str, Any]) -> Any:
        """Announce a case to the adapter's hook; what follows is about this case."""
        del action_case_id, meta
        raise self._without(spec.Message.PREPARE_CASE)

    async def trial_end(self, result: Mapping[str, Any] | None) -> Any:
        """Tell the adapter's hook how the trial ended."""
        del result
        raise self._without(spec.Message.TRIAL_END)

    async def health(self) -> Payload:
        """Return the server's state; answered while the model loads or thinks, too."""
        raise self._without(spec.Message.HEARTBEAT)

    async def settle(self) -> None:
        """Wait until every update that was sent ahead is answered."""

    async def call_method(self, name: str, obs: Any = None) -> Any:
        """Call a method that the adapter declares besides the contract."""
        del obs
        raise self._without(name)

    async def call(self, func_name: str | None, obs: Any = None) -> Any:
        """Call an operation by name, as benchmarks do; further names are methods the adapter declares.

        Raises:
            NoOperationError: the name is none of an operation that anybody may call, or that this wire knows.
            ValueError, TypeError: prepare_case without a case, or something else than a map for what takes one.
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
        spec.Method.UPDATE_OBS: lambda self, obs: self.update_obs(obs),
        spec.Method.UPDATE_OBS_BATCH: lambda self, obs: self.update_obs_batch(obs),
        spec.Method.GET_ACTION: lambda self, obs: self.get_action(obs),
        spec.Method.GET_ACTION_BATCH: lambda self, obs: self.get_action_batch(obs),
        spec.Message.INFER: lambda self, obs: self.infer(obs),
        spec.Message.PREPARE_CASE: _prepare,
        spec.Message.TRIAL_END: lambda self, obs: self.trial_end(_map(spec.Message.TRIAL_END, obs)),
        spec.Message.HEARTBEAT: lambda self, _: self.health(),
    }

    def _without(self, name: str) -> NoOperationError:
        return NoOperationError(f"the wire {self._setup.wire} has no {name}")


def _map(operation: str, obs: object) -> Mapping[str, Any]:
    """Return what is told with an operation that takes a map or nothing.

    Raises:
        TypeError: it is something else, which would be lost.
    """
    if obs is not None and not isinstance(obs, Mapping):
        raise TypeError(f"{operation} takes a map or None, got {type(obs).__name__}")
    return obs or {}
