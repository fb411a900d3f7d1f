"""Requests to a policy server and their answers: connecting, once only each, through cuts; without I/O of its own.

Written with `async`, and driven by two clients: `xpl.client.Client` gives it a transport whose methods block and so
never suspend, `xpl.client.aio.AsyncClient` one that does.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import time
import uuid
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl.client import agreement, retrying, wires
from xpl.client.encoding import Encoder
from xpl.client.errors import (
    ClientError,
    EnvironmentMismatchError,
    PolicyServerError,
    RequestTimeoutError,
    ServerConnectionError,
    ServerFailedError,
    ServerRestartedError,
    of_answer,
)
from xpl.client.retrying import after, left
from xpl.wire import codec, packed

if TYPE_CHECKING:
    from xpl.client.labels import Labels
    from xpl.client.transport import Transport, Wishes
    from xpl.contract import Announcement, Config, Payload, State

_UNCOUNTED = (spec.ErrorReason.UNREADABLE, spec.ErrorReason.SHUTTING_DOWN, *retrying.AGAIN)
_BETWEEN_EPISODES = (spec.Message.RESET, spec.Message.HEARTBEAT, spec.Message.PREPARE_CASE, spec.Message.TRIAL_END)
_LOADING_POLL_S = 0.5
_GOODBYE_S = 0.2


@dataclass
class _Ahead:
    """An update that was sent ahead: its answer is still to come.

    Attributes:
        frame: the request.
        data: its bytes, if they do not point into memory that was shared over a lost connection.
        blocks: blocks of shared memory that it uses.
    """

    frame: codec.Frame
    data: bytes | None
    blocks: list[int]


class Exchange:
    """A connection that survives cuts, and the requests over it.

    Attributes:
        step: step of the episode, which every request carries.
        server_instance_id: what the server called itself, None for one of the first generation.
        capabilities: what it announced.
        policy: what its policy needs (`xpl.client.agreement`).
    """

    def __init__(
        self,
        transport: Transport,
        address: str,
        timing: Config,
        wishes: Wishes,
        labels: Labels,
    ) -> None:
        self._transport = transport
        self._address = address
        self._config = timing
        self._wishes = wishes
        self._labels = labels
        self._session = uuid.uuid4().hex
        self._numbers = itertools.count()
        self.step = 0
        self._is_open = False
        self._is_lost = False
        self._encoder = Encoder(packed=wishes.packed, jpeg=wishes.jpeg)
        self._ahead: OrderedDict[str, _Ahead] = OrderedDict()
        self._late: PolicyServerError | None = None
        self._sequence = 0
        self.server_instance_id: str | None = None
        self.capabilities: Mapping[str, Any] = {}
        self.policy: Announcement = {}

    # -- connecting ----------------------------------------------------------------------------------------------------

    async def connect(self, deadline: float = math.inf) -> None:
        """Connect and exchange hellos, trying again while nobody listens, the model loads or the server is busy."""
        deadline = min(deadline, retrying.connect_deadline(self._config))
        once = partial(self._connect_once, deadline)
        server = f"policy server at {self._address}"
        await retrying.connected(once, self._transport.pause, self._config, server, deadline)

    async def _connect_once(self, deadline: float) -> None:
        timeout = left(min(deadline, after(self._config[spec.Deploy.CONNECT_TIMEOUT_S])))
        await self._transport.open(timeout)
        self._is_open = True
        try:
            greeting = await self._hello({})
            while greeting.get(spec.Payload.STATE) == spec.ServerState.LOADING:
                greeting = await self._wait_for_the_model(greeting, deadline)
            instance = greeting.get(spec.Payload.SERVER_INSTANCE_ID)
            if instance != self.server_instance_id:
                self._sequence = 0
            self.server_instance_id = instance
            self.capabilities = self._encoder.capabilities = _map(greeting.get(spec.Payload.CAPABILITIES))
            self.policy = _map(greeting.get(spec.Payload.POLICY))
            self._check_fit()
            await self._share(self.capabilities.get(spec.Capability.SHARED_MEMORY))
        except BaseException:
            await self.close()
            raise

    async def _hello(self, shared_memory: Mapping[str, Any]) -> Payload:
        wishes = self._wishes
        capabilities: dict[str, Any] = {
            spec.Capability.WIRE_VERSION: spec.WIRE_VERSION,
            spec.Capability.LOADING: True,
            spec.Capability.SEQUENCE: True,
            spec.Capability.SESSION: self._session,
        }
        if wishes.packed:
            capabilities[spec.Capability.PACKED] = 1
            if wishes.shared_memory:
                capabilities[spec.Capability.SHARED_MEMORY] = shared_memory or {"wanted": True}
        if wishes.jpeg:
            capabilities[spec.Capability.JPEG] = dict(wishes.jpeg)
        payload: Payload = {spec.Payload.CAPABILITIES: capabilities}
        if wishes.environment is not None:
            payload[spec.Payload.ENVIRONMENT] = dict(wishes.environment)
        hello = self._frame(spec.Message.HELLO, payload)
        limit = after(self._config[spec.Deploy.HANDSHAKE_TIMEOUT_S])
        return await self._exchange(hello, codec.encode(hello), limit)

    async def _wait_for_the_model(self, greeting: Mapping[str, Any], deadline: float) -> Payload:
        """Ask how far the model is until it is loaded, and return the answer to another hello."""
        state: State = greeting
        while state.get(spec.Payload.STATE) == spec.ServerState.LOADING:
            if self._wishes.on_loading is not None:
                self._wishes.on_loading(_map(state.get(spec.Payload.PROGRESS)))
            if time.monotonic() > deadline:
                raise ServerConnectionError(f"the model at {self._address} was still loading when time was up")
            await self._transport.pause(_LOADING_POLL_S)
            beat = self._frame(spec.Message.HEARTBEAT, {})
            limit = after(self._config[spec.Deploy.HANDSHAKE_TIMEOUT_S])
            state = await self._exchange(beat, codec.encode(beat), limit)
        return await self._hello({})

    def _check_fit(self) -> None:
        """Compare what both sides announced: a server of another make may not have done so."""
        try:
            policy = agreement.checked(self.policy)
        except agreement.AnnouncementError as error:
            raise ClientError(f"what the server announced of its policy cannot be understood: {error}") from None
        found = agreement.differences(policy, self._wishes.environment or {})
        if found:
            details = {"reason": spec.ErrorReason.MISMATCH, "differences": found}
            raise EnvironmentMismatchError(spec.ErrorCode.INVALID_FRAME, agreement.sentence(found), details)

    async def _share(self, offer: object) -> None:
        """Use the memory that the server offers, once both sides have read there what the other one wrote."""
        proof = self._encoder.share(offer) if isinstance(offer, Mapping) and self._wishes.shared_memory else None
        if proof is not None:
            greeting = await self._hello({"proof": proof})
            announced = _map(greeting.get(spec.Payload.CAPABILITIES)).get(spec.Capability.SHARED_MEMORY)
            self._encoder.confirm(_map(announced).get("proof"))

    async def close(self) -> None:
        """Say goodbye and close the connection; closing twice is fine."""
        if not self._is_open:
            return
        with contextlib.suppress(Exception):  # the connection may be gone already, which is what was wanted
            await self._transport.send(codec.encode(self._frame(spec.Message.CLOSE, {})), _GOODBYE_S)
        await self._drop()

    # -- requests ------------------------------------------------------------------------------------------------------

    @property
    def is_first_generation(self) -> bool:
        """Whether the server is of the first generation: it knows infer and reset, and remembers no answers."""
        return self.server_instance_id is None

    @property
    def goes_ahead(self) -> bool:
        """Whether updates are sent without waiting for their answers."""
        return self._wishes.pipelined and bool(self.capabilities.get(spec.Capability.SEQUENCE))

    def begin_episode(self) -> None:
        """Go on from the first step, whatever became of the episode before."""
        self.step = 0
        self._is_lost = False

    async def send_ahead(self, payload: Payload) -> None:
        """Send a call without waiting for its answer; what goes wrong with it is raised by what is asked next."""
        self._check_open(spec.Message.CALL)
        while len(self._ahead) >= spec.LIMITS["pipelined"]:
            await self._receive_ahead()
        self._raise_late()
        frame, data, blocks = self._numbered(spec.Message.CALL, payload)
        deadline = self._request_deadline()
        self._ahead[frame.message_id] = _Ahead(frame, None if blocks else data, blocks)
        try:
            await self._transport.send(data, left(deadline))
        except OSError as error:
            await self._reconnect(error, deadline)

    async def settle(self) -> None:
        """Wait for the answers to all updates that were sent ahead, and raise what went wrong with them."""
        while self._ahead:
            await self._receive_ahead()
        self._raise_late()

    async def _receive_ahead(self) -> None:
        """Take in one more answer to what was sent ahead."""
        deadline = self._request_deadline()
        try:
            self._take(codec.decode(await self._transport.receive(left(deadline))))
        except OSError as error:
            if isinstance(error, TimeoutError):
                raise await self._ended(error, "an update that was sent ahead was not answered in time") from None
            await self._reconnect(error, deadline)
        except (ServerFailedError, codec.WireError) as error:
            raise await self._ended(error) from None

    def _frame(self, message_type: str, payload: Payload) -> codec.Frame:
        identity = f"{self._session}-{next(self._numbers)}"
        return codec.Frame(message_type, payload=payload, message_id=identity, step=self.step, **vars(self._labels))

    def _numbered(self, message_type: str, payload: Payload) -> tuple[codec.Frame, bytes, list[int]]:
        """Return a request with its number, where the server counts, too; its bytes and its blocks."""
        counts = message_type != spec.Message.HEARTBEAT and bool(self.capabilities.get(spec.Capability.SEQUENCE))
        frame = self._frame(message_type, {**payload, spec.Payload.SEQUENCE: self._sequence} if counts else payload)
        data, blocks = self._encoder.encode(frame)
        self._sequence += counts  # not before: what cannot be sent has no number
        return frame, data, blocks

    async def request(self, message_type: str, payload: Payload) -> Payload:
        """Return the payload of the answer; reconnects once after a cut, all within the request's timeout."""
        self._check_open(message_type)
        frame, data, blocks = self._numbered(message_type, payload)
        deadline = self._request_deadline()
        try:
            answer = await self._exchange(frame, data, deadline)
        except PolicyServerError:
            self._raise_late()  # what failed before it is the cause
            raise
        except OSError as error:
            await self._reconnect(error, deadline)
            # Again: what lay in the memory of the lost connection lies elsewhere now.
            data, blocks = self._encoder.encode(frame)
            try:
                # The same id: the server answers from its memory if the model ran already.
                answer = await self._exchange(frame, data, deadline)
            except OSError as again:
                await self._drop()
                raise ServerConnectionError(f"the connection was cut twice during one request: {again}") from None
        finally:
            self._encoder.answered(blocks)
        self._raise_late()
        return answer

    def _check_open(self, message_type: str) -> None:
        """Refuse what cannot be asked: the client is closed, or the episode's state was lost and not yet reset."""
        if not self._is_open:
            raise ServerConnectionError("the client is closed")
        if self._is_lost and message_type not in _BETWEEN_EPISODES:
            raise ServerRestartedError("the policy server was restarted: the episode's state is gone; reset") from None

    async def _reconnect(self, error: OSError, deadline: float) -> None:
        """Come back to the same server after a cut, and send again what was sent ahead and not answered."""
        await self._drop()
        if self.is_first_generation:
            raise ServerConnectionError(
                f"the connection was cut ({error}), and a server of the first generation must not be asked twice"
            ) from None
        ahead = list(self._ahead.values())
        if any(update.data is None for update in ahead):
            self._ahead.clear()
            raise ServerConnectionError(
                f"the connection was cut ({error}) while updates were sent ahead through shared memory"
            ) from None
        instance = self.server_instance_id
        await self.connect(deadline)
        if self.server_instance_id != instance:
            self._is_lost = True
            self._ahead.clear()
            self._check_open(spec.Message.CALL)
        try:
            for update in ahead:
                await self._transport.send(update.data or b"", left(deadline))
        except OSError as again:
            await self._drop()
            raise ServerConnectionError(f"the connection was cut twice during one request: {again}") from None

    async def _exchange(self, frame: codec.Frame, data: bytes, deadline: float) -> Payload:
        """Send a request and return the payload of its answer; a lost connection is an OSError."""
        started = time.monotonic()
        try:
            await self._transport.send(data, left(deadline))
            while True:
                data = await self._transport.receive(left(deadline))
                is_hello = frame.message_type == spec.Message.HELLO
                answer = wires.greeting(data, self._address) if is_hello else codec.decode(data)
                if answer.message_id == frame.message_id:
                    return self._read(answer, frame)
                self._take(answer)
        except TimeoutError as error:
            waited = time.monotonic() - started
            raise await self._ended(error, f"{frame.message_type} was not answered within {waited:.1f} s") from None
        except (ServerFailedError, codec.WireError, packed.PackingError) as error:
            raise await self._ended(error) from None
        except BaseException as error:
            if not isinstance(error, Exception):  # cancelled, or interrupted: nobody knows what became of the request
                await self.close()
            raise

    async def _ended(self, error: Exception, late: str = "") -> ClientError:
        """End the connection after an error that no second attempt can mend, and return how it is reported."""
        if isinstance(error, TimeoutError):
            await self.close()
            return RequestTimeoutError(late)
        await self._drop()
        if isinstance(error, ServerFailedError):
            return error
        return ClientError(f"what the server sent cannot be understood: {error}")

    def _take(self, answer: codec.Frame) -> None:
        """Take in the answer to an update that was sent ahead; others are not ours."""
        update = self._ahead.pop(answer.message_id, None)
        if update is None:
            return
        self._encoder.answered(update.blocks)
        try:
            self._read(answer, update.frame)
        except PolicyServerError as error:
            self._late = self._late or error

    def _read(self, answer: codec.Frame, request: codec.Frame) -> Payload:
        """Return the payload of an answer; an error that the server did not count is not counted here either."""
        try:
            return _payload(answer, request)
        except PolicyServerError as error:
            number = request.payload.get(spec.Payload.SEQUENCE)
            if error.details.get("reason") in _UNCOUNTED and number == self._sequence - 1:
                self._sequence -= 1
            raise

    def _raise_late(self) -> None:
        late, self._late = self._late, None
        if late is not None:
            raise late

    def _request_deadline(self) -> float:
        return after(self._config[spec.Deploy.REQUEST_TIMEOUT_S])

    async def _drop(self) -> None:
        """Close the connection, if there is one, without a goodbye."""
        self._is_open = False
        self._encoder.forget()
        await self._transport.close()


def _map(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _payload(answer: codec.Frame, request: codec.Frame) -> Payload:
    payload = answer.payload
    if answer.message_type == spec.Message.ERROR:
        raise of_answer(payload)
    if answer.message_type != spec.ANSWERS[request.message_type]:
        raise ClientError(f"{request.message_type} was answered by {answer.message_type:.80}")
    return codec.unpacked(payload)
