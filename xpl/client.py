"""The environment side of the wire: a blocking client (extra `client`: websockets >= 12, msgpack).

    with Client("ws://localhost:8000") as policy:
        policy.reset()
        policy.update_obs(observation)
        chunk = policy.get_action()

`call(func_name=..., obs=...)` is the same in the style that benchmarks use. Against a server of the first generation,
which knows no `call`, observations are held back and sent with `infer`, and a batch is one infer per environment.
"""

from __future__ import annotations

import time
import uuid
from collections.abc import Mapping, Sequence
from typing import Any, Optional

from xpl import _spec as spec
from xpl import wire

_D = spec.DEPLOY_DEFAULTS


class ClientError(RuntimeError):
    """Base class of what can go wrong between an environment and a policy server."""


class PolicyServerError(ClientError):
    """The server answered with an error; the policy raised, or refused the request.

    Attributes:
        code: one of the wire's error codes.
        details: map with, for example, a finer `reason`.
    """

    def __init__(self, code: str, message: str, details: Optional[Mapping[str, Any]] = None) -> None:
        super().__init__(f"{code}: {message}")
        self.code = code
        self.details = dict(details or {})


class ServerConnectionError(ClientError):
    """The server cannot be reached, or a connection was lost and the trial cannot go on."""


class ServerRestartedError(ServerConnectionError):
    """Another server instance answers now: the episode's state is gone, the trial must be aborted."""


class RequestTimeoutError(ClientError):
    """A request was not answered in time; the trial must be aborted."""


class Client:
    """A connection to a policy server.

    Args:
        url: `ws://host:port`.
        evaluation_id: name of the evaluation; made up if not given.
        trial_id: name of the trial, where the benchmark has one.
        config: the timing keys of deploy.yml; the spec's defaults otherwise. null in a limit means none.

    Raises:
        ServerConnectionError: if no connection came about within the limits.
        PolicyServerError: if the server refused the hello for good.
    """

    def __init__(
        self,
        url: str,
        *,
        evaluation_id: Optional[str] = None,
        trial_id: Optional[str] = None,
        config: Optional[Mapping[str, Any]] = None,
    ) -> None:
        self._url = url
        self._config = {**_D, **(config or {})}
        self._evaluation_id = evaluation_id or uuid.uuid4().hex
        self._trial_id = trial_id
        self._step = 0
        self._socket: Any = None
        self._held: list[Mapping[str, Any]] = []
        self.server_instance_id: Optional[str] = None
        self._connect()

    # -- the operations of the contract --------------------------------------------------------------------------------

    def reset(self) -> None:
        """Start a new episode."""
        self._step = 0
        self._held = []
        self._request(spec.Message.RESET, {spec.Payload.TRIAL_ID: self._trial_id})

    def update_obs(self, obs: Mapping[str, Any]) -> None:
        """Show the policy the newest observation of one environment."""
        self._held = [obs]
        if not self._first_generation:
            self._call(spec.Method.UPDATE_OBS, obs)

    def update_obs_batch(self, obs_list: Sequence[Mapping[str, Any]]) -> None:
        """Show the policy the newest observation of several environments."""
        self._held = list(obs_list)
        if not self._first_generation:
            self._call(spec.Method.UPDATE_OBS_BATCH, list(obs_list))

    def get_action(self, obs: Optional[Mapping[str, Any]] = None) -> Any:
        """Return an action chunk, for `obs` if it is given and for the last observation otherwise."""
        if obs is not None:
            return self.infer(obs)
        if self._first_generation:
            if len(self._held) != 1:
                raise ClientError("get_action needs exactly one observation since the last reset")
            return self.infer(self._held[0])
        return self._call(spec.Method.GET_ACTION)

    def get_action_batch(self, env_idx_list: Optional[Sequence[int]] = None) -> Any:
        """Return one action chunk per environment of the list; None means the last batch."""
        if not self._first_generation:
            return self._call(spec.Method.GET_ACTION_BATCH, None if env_idx_list is None else list(env_idx_list))
        held = {obs.get(spec.Obs.ENV_IDX, position): obs for position, obs in enumerate(self._held)}
        wanted = list(held) if env_idx_list is None else list(env_idx_list)
        missing = [index for index in wanted if index not in held]
        if missing:
            raise ClientError(f"environments {missing} have no observation; there are {list(held)}")
        return [self.infer(held[index]) for index in wanted]

    # -- the other requests --------------------------------------------------------------------------------------------

    def infer(self, obs: Mapping[str, Any]) -> Any:
        """Return the action chunk for one observation: update_obs and get_action as one unit."""
        actions = self._request(spec.Message.INFER, {spec.Payload.OBSERVATION: obs})[spec.Payload.ACTIONS]
        self._step += 1
        return actions

    def prepare_case(self, action_case_id: str, **meta: Any) -> Any:
        """Announce a case to the adapter's hook."""
        payload = {spec.Payload.ACTION_CASE_ID: action_case_id, **meta}
        return self._request(spec.Message.PREPARE_CASE, payload).get(spec.Payload.RESULT)

    def trial_end(self, result: Optional[Mapping[str, Any]] = None) -> Any:
        """Tell the adapter's hook how the trial ended."""
        payload = {spec.Payload.TRIAL_ID: self._trial_id, **(result or {})}
        return self._request(spec.Message.TRIAL_END, payload).get(spec.Payload.RESULT)

    def heartbeat(self) -> None:
        """Ask for a sign of life; answered while the model thinks, too."""
        self._request(spec.Message.HEARTBEAT, {})

    def call(self, func_name: str, obs: Any = None) -> Any:
        """Call an operation by name, as benchmarks do; further names are methods the adapter declares."""
        operations = {
            spec.Method.RESET: lambda: self.reset(),
            spec.Method.UPDATE_OBS: lambda: self.update_obs(obs),
            spec.Method.UPDATE_OBS_BATCH: lambda: self.update_obs_batch(obs),
            spec.Method.GET_ACTION: lambda: self.get_action(obs),
            spec.Method.GET_ACTION_BATCH: lambda: self.get_action_batch(obs),
        }
        if func_name in operations:
            return operations[func_name]()
        if self._first_generation:
            raise ClientError(f"this server offers no {func_name!r}: it is of the first generation, without `call`")
        return self._call(func_name, obs)

    def close(self) -> None:
        """Say goodbye and close the connection; closing twice is fine."""
        if self._socket is None:
            return
        try:
            self._socket.send(wire.encode(self._frame(spec.Message.CLOSE, {})))
            self._socket.close()
        except Exception:  # noqa: BLE001, S110 - the connection may be gone already, which is what was wanted
            pass
        self._socket = None

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- inside --------------------------------------------------------------------------------------------------------

    @property
    def _first_generation(self) -> bool:
        return self.server_instance_id is None

    def _call(self, name: str, obs: Any = None) -> Any:
        payload = {spec.Payload.FUNC_NAME: name}
        if obs is not None:
            payload[spec.Payload.OBS] = obs
        return self._request(spec.Message.CALL, payload).get(spec.Payload.RESULT)

    def _frame(self, message_type: str, payload: dict[str, Any]) -> wire.Frame:
        return wire.Frame(message_type, self._evaluation_id, payload, trial_id=self._trial_id, step=self._step)

    def _request(self, message_type: str, payload: dict[str, Any]) -> dict[str, Any]:
        if self._socket is None:
            raise ServerConnectionError("the client is closed")
        frame = self._frame(message_type, payload)
        data = wire.encode(frame)
        try:
            return self._exchange(frame, data, self._config[spec.Deploy.REQUEST_TIMEOUT_S])
        except OSError:
            if self._first_generation:
                raise ServerConnectionError("the connection was cut; a server of the first generation may not be asked again") from None
        instance = self.server_instance_id
        self._connect()
        if self.server_instance_id != instance:
            raise ServerRestartedError("the policy server was restarted: the episode's state is gone") from None
        try:
            # The same id: the server answers from its memory if the model ran already.
            return self._exchange(frame, data, self._config[spec.Deploy.REQUEST_TIMEOUT_S])
        except OSError:
            raise ServerConnectionError("the connection was cut twice during one request") from None

    def _exchange(self, frame: wire.Frame, data: bytes, timeout: Optional[float]) -> dict[str, Any]:
        """Send a request and return the payload of its answer; a lost connection is an OSError."""
        from websockets.exceptions import ConnectionClosed

        deadline = None if timeout is None else time.monotonic() + timeout
        try:
            self._socket.send(data)
            while True:
                left = None if deadline is None else max(0.0, deadline - time.monotonic())
                answer = wire.decode(self._socket.recv(timeout=left))
                if answer.message_id == frame.message_id:
                    return _payload(answer, frame)
        except TimeoutError:
            self.close()
            raise RequestTimeoutError(f"{frame.message_type} was not answered within {timeout} s") from None
        except ConnectionClosed as error:
            raise ConnectionResetError(str(error)) from None

    def _connect(self) -> None:
        config = self._config
        limit = config[spec.Deploy.MAX_CONNECT_SECONDS]
        deadline = time.monotonic() + limit if limit else float("inf")
        attempts = config[spec.Deploy.MAX_CONNECT_ATTEMPTS]
        problem = "no attempt was allowed"
        for attempt in range(attempts):
            if attempt:
                if time.monotonic() + config[spec.Deploy.CONNECT_RETRY_DELAY_S] > deadline:
                    break
                time.sleep(config[spec.Deploy.CONNECT_RETRY_DELAY_S])
            try:
                return self._connect_once()
            except (OSError, RequestTimeoutError) as error:
                problem = str(error)
            except PolicyServerError as error:
                if error.details.get("reason") != spec.ErrorReason.BUSY:
                    raise
                problem = str(error)
        raise ServerConnectionError(f"no policy server at {self._url} after {attempt + 1} attempts: {problem}")

    def _connect_once(self) -> None:
        from websockets.sync.client import connect

        config = self._config
        self._socket = connect(
            self._url,
            compression=None,
            max_size=None,
            open_timeout=config[spec.Deploy.CONNECT_TIMEOUT_S],
            close_timeout=config[spec.Deploy.CLOSE_TIMEOUT_S],
        )
        frame = self._frame(spec.Message.HELLO, {spec.Payload.CAPABILITIES: {"wire_version": spec.WIRE_VERSION}})
        try:
            greeting = self._exchange(frame, wire.encode(frame), config[spec.Deploy.HANDSHAKE_TIMEOUT_S])
        except PolicyServerError:
            self.close()
            raise
        self.server_instance_id = greeting.get(spec.Payload.SERVER_INSTANCE_ID)


def _payload(answer: wire.Frame, request: wire.Frame) -> dict[str, Any]:
    payload = answer.payload
    if answer.message_type == spec.Message.ERROR:
        code, message = str(payload.get(spec.Payload.CODE)), str(payload.get(spec.Payload.MESSAGE))
        raise PolicyServerError(code, message, payload.get(spec.Payload.DETAILS))
    if answer.message_type != spec.ANSWERS[request.message_type]:
        raise ClientError(f"{request.message_type} was answered by {answer.message_type}")
    return payload
