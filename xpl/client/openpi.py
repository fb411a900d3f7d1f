"""A client of openpi's policy servers, with the operations of `xpl.Client` (extra `client`: websockets, msgpack).

openpi's wire has no reset, and a server may keep state per connection: each environment gets a connection of its own,
and a new one with each episode.
"""

from __future__ import annotations

import itertools
import math
import threading
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl.client import makes
from xpl.client.connection import BlockingTransport
from xpl.client.errors import (
    ClientError,
    PolicyServerError,
    RequestTimeoutError,
    ServerConnectionError,
    ServerFailedError,
)
from xpl.client.transport import run
from xpl.observation import env_index, env_indices
from xpl.openpi import codec
from xpl.openpi.names import Names
from xpl.policy import PolicyStateError
from xpl.wire.codec import WireError

if TYPE_CHECKING:
    import ssl

_SCHEME = "Api-Key"


class OpenpiClient:
    """Connections to an openpi server. Its methods may be called from several threads; they take turns.

    Args:
        url: `ws://host:port`, or `wss://`.
        config: values of deploy.yml: `openpi`, `env_cfg_type`, `action_type`, the timing keys; and `manifest`, the
            parsed policy.yml, where there is one.
        token: API key, where the server asks for one.
        ssl_context: for `wss://`, where the system's certificates are not enough.

    Attributes:
        metadata: what the server said of itself.

    Raises:
        ConfigError: if `openpi` of the configuration is missing or unclear.
        ServerConnectionError: if no connection came about within the limits, or another make of server answers.
    """

    def __init__(
        self,
        url: str,
        *,
        config: Mapping[str, Any],
        token: str | None = None,
        ssl_context: ssl.SSLContext | None = None,
    ) -> None:
        self._url = url
        self._names = Names.of(config)
        self._timing = {**spec.DEPLOY_DEFAULTS, **config}
        self._token = token
        self._ssl = ssl_context
        self._turn = threading.Lock()
        self._newest: dict[int, Mapping[str, Any]] = {}
        self._order: list[int] | None = None
        self._connections: dict[int, BlockingTransport] = {}
        self._raised: set[int] = set()
        self._lost: set[int] = set()
        self.metadata: Mapping[str, Any] = {}
        with self._turn:
            # That the server is there shows now, and not when a robot waits; the first environment goes on with it.
            self._spare: BlockingTransport | None = self._connect()

    def update_obs(self, obs: Mapping[str, Any]) -> None:
        """Keep the newest observation of one environment; it travels when it is asked about."""
        index = obs.get(spec.Obs.ENV_IDX)
        self._observe([obs], [0 if index is None else env_index(index)])

    def update_obs_batch(self, obs_list: Sequence[Mapping[str, Any]]) -> None:
        """Keep the newest observation of several environments."""
        self._observe(obs_list, env_indices(obs_list))

    def infer(self, obs: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Return the action chunk for one observation."""
        return self.get_action(obs)

    def get_action(self, obs: Mapping[str, Any] | None = None) -> list[dict[str, Any]]:
        """Return the action chunk for `obs` if it is given, and otherwise for the environment that was observed last.

        Raises:
            PolicyStateError: before an observation, or after a batch of several.
        """
        if obs is not None:
            self.update_obs(obs)
        if self._order is None or len(self._order) != 1:
            raise PolicyStateError(f"get_action answers one environment that was observed, the last were {self._order}")
        return self.get_action_batch(self._order)[0]

    def get_action_batch(self, env_idx_list: Sequence[int] | None = None) -> list[list[dict[str, Any]]]:
        """Return the action chunks of these environments, in this order; None means the last batch.

        The wire knows no batches: the environments are asked about one after the other.

        Raises:
            PolicyStateError: if an environment is unknown or repeated, or nothing was observed.
            ObservationError: if an observation lacks what the server needs.
            ActionError: if the answer holds no actions of this robot.
            PolicyServerError: if the server answered with an error.
            ServerConnectionError: if the connection was lost; the episode's state may be, too.
            RequestTimeoutError: if there was no answer in time.
        """
        with self._turn:
            chosen = self._order if env_idx_list is None else env_idx_list
            envs = None if chosen is None else [env_index(index) for index in chosen]
            if envs is None or len(set(envs)) != len(envs) or not set(envs) <= self._newest.keys():
                raise PolicyStateError(f"environments to answer must be observed, and none twice: {envs}")
            return [self._infer(env) for env in envs]

    def reset(self) -> None:
        """Start a new episode in every environment."""
        with self._turn:
            self._newest.clear()
            self._order = None
            self._lost.clear()
            for env in list(self._connections):
                self._drop(env)

    def close(self) -> None:
        """Close all connections; closing twice is fine."""
        self.reset()
        with self._turn:
            spare, self._spare = self._spare, None
            if spare is not None:
                run(spare.close())

    def __enter__(self) -> OpenpiClient:  # noqa: PYI034 - Self is not in the typing module of Python 3.9
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _observe(self, observations: Sequence[Mapping[str, Any]], envs: list[int]) -> None:
        with self._turn:
            self._newest.update(zip(envs, observations))
            self._order = envs

    # -- requests ------------------------------------------------------------------------------------------------------

    def _infer(self, env: int) -> list[dict[str, Any]]:
        if env in self._lost:
            raise ServerConnectionError(f"the connection of environment {env} was lost, with its episode; reset")
        data = codec.pack(self._names.values(self._newest[env]))
        if env not in self._connections:
            self._connections[env] = self._new()
        try:
            answer = self._ask(env, data)
        except OSError as error:
            raised = env in self._raised
            self._drop(env)
            if isinstance(error, TimeoutError):
                self._lost.add(env)
                raise RequestTimeoutError("the policy server did not answer in time") from None
            if not raised:
                self._lost.add(env)
                raise ServerConnectionError(f"the connection was cut: {error}; reset and begin anew") from None
            # It had answered with an error, and closed then, as openpi's server does: nothing was begun.
            self._connections[env] = self._new()
            answer = self._ask(env, data)
        if isinstance(answer, str):
            self._raised.add(env)
            lines = answer.strip().splitlines() or [""]
            raise PolicyServerError(spec.ErrorCode.INFER_FAILED, lines[-1], {"traceback": answer})
        self._raised.discard(env)
        try:
            return self._names.steps(codec.unpack(answer))
        except WireError as error:
            self._drop(env)
            raise ClientError(f"what the server sent cannot be understood: {error}") from None

    def _ask(self, env: int, data: bytes) -> bytes | str:
        limit = self._timing[spec.Deploy.REQUEST_TIMEOUT_S]
        run(self._connections[env].send(data, limit))
        return run(self._connections[env].receive_any(limit))

    def _new(self) -> BlockingTransport:
        spare, self._spare = self._spare, None
        return spare or self._connect()

    def _drop(self, env: int) -> None:
        connection = self._connections.pop(env, None)
        self._raised.discard(env)
        if connection is not None:
            run(connection.close())

    # -- connecting ----------------------------------------------------------------------------------------------------

    def _connect(self) -> BlockingTransport:
        """Connect and read the metadata, trying again while nobody listens."""
        timing = self._timing
        most = timing[spec.Deploy.MAX_CONNECT_ATTEMPTS] or math.inf
        deadline = time.monotonic() + (timing[spec.Deploy.MAX_CONNECT_SECONDS] or math.inf)
        delay = timing[spec.Deploy.CONNECT_RETRY_DELAY_S] or 0.0
        for attempt in itertools.count(1):
            transport = BlockingTransport(self._url, timing, self._token, self._ssl, self._turn, scheme=_SCHEME)
            try:
                run(transport.open(timing[spec.Deploy.CONNECT_TIMEOUT_S]))
                first = self._first(transport)
            except ServerFailedError:
                raise
            except OSError as error:
                run(transport.close())
                problem = f"{error}"
            else:
                self.metadata = self._greeted(transport, first)
                return transport
            if attempt >= most or time.monotonic() + delay > deadline:
                raise ServerConnectionError(f"no openpi server at {self._url} after {attempt} attempts: {problem}")
            time.sleep(delay)
        raise AssertionError("the attempts never end by themselves")

    def _first(self, transport: BlockingTransport) -> bytes | str:
        """Return what a server says first; one that says nothing says nothing the next time either."""
        try:
            return run(transport.receive_any(self._timing[spec.Deploy.HANDSHAKE_TIMEOUT_S]))
        except TimeoutError:
            run(transport.close())
            raise ServerConnectionError(
                f"the server at {self._url} said nothing in time (handshake_timeout_s): one of openpi sends metadata "
                "first, once its model is loaded; one of xpl waits for hello (`wire: xpl`)"
            ) from None

    def _greeted(self, transport: BlockingTransport, first: bytes | str) -> Mapping[str, Any]:
        """Return the metadata that a server sends first."""
        if isinstance(first, str):
            run(transport.close())
            raise ServerConnectionError(f"the server at {self._url} refused the connection: {first.strip()}")
        if not makes.is_openpi(first):
            run(transport.close())
            raise ServerConnectionError(
                f"what the server at {self._url} sent first is no metadata of an openpi server; {makes.SPOKEN}"
            )
        metadata: Mapping[str, Any] = codec.unpack(first)
        return metadata
