"""The environment side of the wire: a blocking client (extra `client`: websockets >= 12, msgpack).

    with Client("ws://localhost:8000") as policy:
        policy.reset()
        policy.update_obs(observation)
        chunk = policy.get_action()

`call(func_name=..., obs=...)` is the same in the style that benchmarks use: this client takes the place of the
ecosystem's WsModelClient, with all of its arguments. What is spoken is the business of a conversation, which the wire
of the address makes (`xpl.client.wires`). A thread of its own looks after an idle connection, so that a simulator that
blocks misses no ping. `xpl.client.aio` is for asyncio.
"""

from __future__ import annotations

import threading
from collections.abc import Coroutine, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from xpl.client.base import ClientBase
from xpl.client.connection import BlockingTransport
from xpl.client.transport import run

if TYPE_CHECKING:
    from xpl.client.transport import Address, Transport
    from xpl.contract import Observation, Payload

_Value = TypeVar("_Value")


class Client(ClientBase):
    """A connection to a policy server. Its methods may be called from several threads; they take turns.

    Args:
        url: `ws://host:port`, or `wss://`; `openpi+ws://host:port` where the server speaks another wire than xpl's.
        evaluation_id: name of the evaluation; made up if not given.
        trial_id, action_case_id: names of the trial and of its case, where the benchmark has them.
        repeat_index: how often the case was tried before, where the benchmark counts.
        config: the timing keys of deploy.yml; the spec's defaults otherwise. null in a limit means none, and 0 means
            no cap on attempts and on the time to connect. Where `server` is this address, `wire` says what is spoken
            there; a wire may need more of it, as openpi's needs `openpi`.
        token: bearer token, where the server asks for one.
        ssl_context: for `wss://`, where the system's certificates are not enough.
        environment: what the environment offers: `embodiment`, `action_type`, `control_frequency` (Hz), `inputs`. A
            policy that does not fit is refused before the first step.
        jpeg: cameras whose colour is sent as JPEG, with the quality (1..100); all are lossless by default.
        pipelined: send updates without waiting for their answers; their errors are raised by the next operation.
        shared_memory: exchange arrays through memory with a server on this host.
        packed: send payloads in the packed form where the server takes it.
        on_loading: called with `seconds`, `memory_bytes` and `message` while the model loads.
        ws_ping_interval_s, ws_ping_timeout_s: as in config, which they go before; None turns pings off.
        connect_timeout_s, handshake_timeout_s, request_timeout_s, max_connect_attempts, connect_retry_delay_s,
            max_connect_seconds, close_timeout_s: as in config, which they go before; None leaves it to that.
        client: another client, whose connection is used.

    Raises:
        ServerConnectionError: if no connection came about within the limits, or the server said that it failed.
        EnvironmentMismatchError: if policy and environment do not fit.
        PolicyServerError: if the server refused the hello for good.
    """

    def _made(self) -> None:
        self._turn = threading.Lock()

    def _transport(self, there: Address) -> Transport:
        return BlockingTransport(there, self._turn)

    def _begin(self) -> None:
        self._run(self._talk.connect())

    def reset(self) -> None:
        """Start a new episode."""
        self._run(self._talk.reset())

    def update_obs(self, obs: Observation) -> None:
        """Show the policy the newest observation of one environment."""
        self._run(self._talk.update_obs(obs))

    def update_obs_batch(self, obs_list: Sequence[Observation]) -> None:
        """Show the policy the newest observation of several environments."""
        self._run(self._talk.update_obs_batch(obs_list))

    def get_action(self, obs: Observation | None = None) -> Any:
        """Return an action chunk, for `obs` if it is given and for the last observation otherwise."""
        return self._run(self._talk.get_action(obs))

    def get_action_batch(self, env_idx_list: Sequence[int] | None = None) -> Any:
        """Return one action chunk per environment of the list; None means the last batch."""
        return self._run(self._talk.get_action_batch(env_idx_list))

    def infer(self, obs: Observation) -> Any:
        """Return the action chunk for one observation: update_obs and get_action as one unit."""
        return self._run(self._talk.infer(obs))

    def prepare_case(self, action_case_id: str, **meta: Any) -> Any:
        """Announce a case to the adapter's hook."""
        return self._run(self._talk.prepare_case(action_case_id, meta))

    def trial_end(self, result: Mapping[str, Any] | None = None) -> Any:
        """Tell the adapter's hook how the trial ended."""
        return self._run(self._talk.trial_end(result))

    def heartbeat(self) -> None:
        """Ask for a sign of life; answered while the model thinks, too."""
        self._run(self._talk.health())

    def health(self) -> Payload:
        """Return the server's state: `state` is loading, ready or draining."""
        return self._run(self._talk.health())

    def call(self, func_name: str | None = None, obs: Any = None) -> Any:
        """Call an operation by name, as benchmarks do; further names are methods the adapter declares.

        Args:
            func_name: an operation of the contract (`reset`, `update_obs`, `get_action`, ...), one of the wire
                (`prepare_case`, `trial_end`, `infer`, `heartbeat`), or a method of the adapter.
            obs: what goes with it: an observation, a list of them, indices of environments, a map for the hooks.

        Raises:
            NoOperationError: a NotImplementedError; the name is none that anybody may call.
            ValueError: prepare_case, and the client has no `action_case_id`.
            TypeError: something else than a map for what takes a map or nothing.
        """
        return self._run(self._talk.call(func_name, obs))

    def settle(self) -> None:
        """Wait until every update that was sent ahead is answered, and raise what went wrong with one."""
        self._run(self._talk.settle())

    def close(self) -> None:
        """Say goodbye and close the connection; closing twice is fine."""
        self._run(self._talk.close())

    def __enter__(self) -> Client:  # noqa: PYI034 - Self is not in the typing module of Python 3.9
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self, talk: Coroutine[Any, Any, _Value]) -> _Value:
        with self._turn:
            return run(talk)
