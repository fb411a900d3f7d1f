"""The environment side of the wire: a blocking client (extra `client`: websockets >= 12, msgpack).

    with Client("ws://localhost:8000") as policy:
        policy.reset()
        policy.update_obs(observation)
        chunk = policy.get_action()

`call(func_name=..., obs=...)` is the same in the style that benchmarks use. Against a server of the first generation,
which knows no `call`, observations are held back and sent with `infer`, and a batch is one infer per environment.
"""

from __future__ import annotations

import contextlib
import inspect
import itertools
import math
import time
import uuid
from collections.abc import Mapping, Sequence
from typing import Any, Callable

from xpl import _spec as spec
from xpl import wire
from xpl.observation import env_indices

_CODES = frozenset(value for name, value in vars(spec.ErrorCode).items() if name.isupper())


class ClientError(RuntimeError):
    """Base class of what can go wrong between an environment and a policy server."""


class PolicyServerError(ClientError):
    """The server answered with an error; the policy raised, or refused the request.

    Attributes:
        code: one of the wire's error codes.
        details: map with, for example, a finer `reason`.
    """

    def __init__(self, code: str, message: str, details: Mapping[str, Any] | None = None) -> None:
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
        config: the timing keys of deploy.yml; the spec's defaults otherwise. null in a limit means none, and 0 means
            no cap on attempts and on the time to connect.

    Raises:
        ServerConnectionError: if no connection came about within the limits, or the server said that it failed.
        PolicyServerError: if the server refused the hello for good.
    """

    def __init__(
        self,
        url: str,
        *,
        evaluation_id: str | None = None,
        trial_id: str | None = None,
        config: Mapping[str, Any] | None = None,
    ) -> None:
        self._url = url
        self._config = {**spec.DEPLOY_DEFAULTS, **(config or {})}
        self._evaluation_id = evaluation_id or uuid.uuid4().hex
        self._trial_id = trial_id
        self._step = 0
        self._socket: Any = None
        self._open = contextlib.ExitStack()
        self._held: list[Mapping[str, Any]] = []
        self.server_instance_id: str | None = None
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

    def get_action(self, obs: Mapping[str, Any] | None = None) -> Any:
        """Return an action chunk, for `obs` if it is given and for the last observation otherwise."""
        if obs is not None:
            return self.infer(obs)
        if self._first_generation:
            if len(self._held) != 1:
                raise ClientError("get_action needs exactly one observation since the last reset")
            return self.infer(self._held[0])
        return self._call(spec.Method.GET_ACTION)

    def get_action_batch(self, env_idx_list: Sequence[int] | None = None) -> Any:
        """Return one action chunk per environment of the list; None means the last batch."""
        if not self._first_generation:
            return self._call(spec.Method.GET_ACTION_BATCH, None if env_idx_list is None else list(env_idx_list))
        held = dict(zip(env_indices(self._held), self._held))
        wanted = list(held) if env_idx_list is None else list(env_idx_list)
        missing = [index for index in wanted if index not in held]
        if missing or len(set(wanted)) != len(wanted):
            raise ClientError(f"expected environments out of {list(held)}, each once; got {wanted}")
        # Each infer stands alone there, so an index that followed from the position in the batch has to be written.
        return [self.infer({**held[index], spec.Obs.ENV_IDX: index}) for index in wanted]

    # -- the other requests --------------------------------------------------------------------------------------------

    def infer(self, obs: Mapping[str, Any]) -> Any:
        """Return the action chunk for one observation: update_obs and get_action as one unit."""
        answer = self._request(spec.Message.INFER, {spec.Payload.OBSERVATION: obs})
        if spec.Payload.ACTIONS not in answer:
            raise ClientError(
                f"the server's answer to infer has no {spec.Payload.ACTIONS!r}; it has {', '.join(answer)}"
            )
        self._step += 1
        return answer[spec.Payload.ACTIONS]

    def prepare_case(self, action_case_id: str, **meta: Any) -> Any:
        """Announce a case to the adapter's hook."""
        payload = {spec.Payload.ACTION_CASE_ID: action_case_id, **meta}
        return self._request(spec.Message.PREPARE_CASE, payload).get(spec.Payload.RESULT)

    def trial_end(self, result: Mapping[str, Any] | None = None) -> Any:
        """Tell the adapter's hook how the trial ended."""
        payload = {spec.Payload.TRIAL_ID: self._trial_id, **(result or {})}
        return self._request(spec.Message.TRIAL_END, payload).get(spec.Payload.RESULT)

    def heartbeat(self) -> None:
        """Ask for a sign of life; answered while the model thinks, too."""
        self._request(spec.Message.HEARTBEAT, {})

    def call(self, func_name: str, obs: Any = None) -> Any:
        """Call an operation by name, as benchmarks do; further names are methods the adapter declares."""
        operations: dict[str, Callable[[], Any]] = {
            spec.Method.RESET: self.reset,
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
        with contextlib.suppress(Exception):  # the connection may be gone already, which is what was wanted
            self._socket.send(wire.encode(self._frame(spec.Message.CLOSE, {})))
        self._drop()

    def __enter__(self) -> Client:  # noqa: PYI034 - Self is not in the typing module of Python 3.9
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
        """Return the payload of the answer; reconnects once after a cut, all within the request's timeout."""
        if self._socket is None:
            raise ServerConnectionError("the client is closed")
        frame = self._frame(message_type, payload)
        data = wire.encode(frame)
        timeout = self._config[spec.Deploy.REQUEST_TIMEOUT_S]
        deadline = _deadline(timeout)
        try:
            return self._exchange(frame, data, deadline)
        except OSError as error:
            self._drop()
            if self._first_generation:
                raise ServerConnectionError(
                    f"the connection was cut ({error}), and a server of the first generation must not be asked twice"
                ) from None
        instance = self.server_instance_id
        self._connect(deadline)
        if self.server_instance_id != instance:
            raise ServerRestartedError("the policy server was restarted: the episode's state is gone") from None
        try:
            # The same id: the server answers from its memory if the model ran already.
            return self._exchange(frame, data, deadline)
        except OSError as error:
            self._drop()
            raise ServerConnectionError(f"the connection was cut twice during one request: {error}") from None

    def _exchange(self, frame: wire.Frame, data: bytes, deadline: float) -> dict[str, Any]:
        """Send a request and return the payload of its answer; a lost connection is an OSError."""
        from websockets.exceptions import ConnectionClosed

        started = time.monotonic()
        try:
            self._socket.send(data)
            while True:
                message = self._socket.recv(timeout=_left(deadline))
                if isinstance(message, str):
                    continue  # the wire is binary only
                answer = wire.decode(message)
                if answer.message_id == frame.message_id:
                    return _payload(answer, frame)
        except TimeoutError:
            self.close()
            waited = time.monotonic() - started
            raise RequestTimeoutError(f"{frame.message_type} was not answered within {waited:.1f} s") from None
        except wire.WireError as error:
            self._drop()
            raise ClientError(f"what the server sent cannot be understood: {error}") from None
        except ConnectionClosed as error:
            if error.rcvd is not None and error.rcvd.code == spec.CLOSE_CODES["server_failed"]:
                self._drop()
                raise ServerConnectionError(f"the policy server ended: {error.rcvd.reason}") from None
            raise ConnectionResetError(str(error)) from None

    def _connect(self, deadline: float = math.inf) -> None:
        """Connect and exchange hellos, trying again while nobody listens, the model loads or the server is busy."""
        config = self._config
        deadline = min(deadline, _deadline(config[spec.Deploy.MAX_CONNECT_SECONDS] or None))
        most = config[spec.Deploy.MAX_CONNECT_ATTEMPTS] or math.inf
        delay = config[spec.Deploy.CONNECT_RETRY_DELAY_S] or 0.0
        for attempt in itertools.count(1):
            try:
                self._connect_once(deadline)
            except (OSError, RequestTimeoutError) as error:
                problem: Exception = error
            except PolicyServerError as error:
                if error.details.get("reason") != spec.ErrorReason.BUSY:
                    raise
                problem = error
            else:
                return
            if attempt >= most or time.monotonic() + delay > deadline:
                raise ServerConnectionError(f"no policy server at {self._url} after {attempt} attempts: {problem}")
            time.sleep(delay)

    def _connect_once(self, deadline: float) -> None:
        from websockets.exceptions import InvalidURI, WebSocketException
        from websockets.sync.client import connect

        config = self._config
        options = {
            "compression": None,
            "max_size": spec.LIMITS["frame_bytes"],
            "open_timeout": _left(min(deadline, _deadline(config[spec.Deploy.CONNECT_TIMEOUT_S]))),
            "close_timeout": config[spec.Deploy.CLOSE_TIMEOUT_S],
        }
        # What later versions of websockets added. Straight to the server, whatever proxy the environment names; and a
        # simulator that keeps the interpreter busy must not be taken for a lost connection.
        later = {"proxy": None, "ping_interval": config[spec.Deploy.WS_PING_INTERVAL_S], "ping_timeout": None}
        known = inspect.signature(connect).parameters
        options.update({name: value for name, value in later.items() if name in known})
        try:
            # As a context, which is the one form that all versions of websockets take.
            self._socket = self._open.enter_context(connect(self._url, **options))
        except InvalidURI as error:
            raise ServerConnectionError(
                f"a policy server's address is ws://host:port, got {self._url!r}: {error}"
            ) from None
        except WebSocketException as error:  # something answers there, but no policy server
            raise ConnectionError(str(error)) from None
        hello = self._frame(spec.Message.HELLO, {spec.Payload.CAPABILITIES: {"wire_version": spec.WIRE_VERSION}})
        limit = min(deadline, _deadline(config[spec.Deploy.HANDSHAKE_TIMEOUT_S]))
        try:
            greeting = self._exchange(hello, wire.encode(hello), limit)
        except BaseException:
            self.close()
            raise
        self.server_instance_id = greeting.get(spec.Payload.SERVER_INSTANCE_ID)

    def _drop(self) -> None:
        """Close the connection, if there is one, without a goodbye."""
        self._socket = None
        with contextlib.suppress(Exception):
            self._open.close()


def _deadline(seconds: float | None) -> float:
    return math.inf if seconds is None else time.monotonic() + seconds


def _left(deadline: float) -> float | None:
    return None if deadline == math.inf else max(0.0, deadline - time.monotonic())


def _payload(answer: wire.Frame, request: wire.Frame) -> dict[str, Any]:
    payload = answer.payload
    if answer.message_type == spec.Message.ERROR:
        code, message = payload.get(spec.Payload.CODE), str(payload.get(spec.Payload.MESSAGE))
        known = str(code) if code in _CODES else spec.ErrorCode.INTERNAL
        details = payload.get(spec.Payload.DETAILS)
        raise PolicyServerError(known, message, details if isinstance(details, Mapping) else None)
    if answer.message_type != spec.ANSWERS[request.message_type]:
        raise ClientError(f"{request.message_type} was answered by {answer.message_type}")
    return payload
