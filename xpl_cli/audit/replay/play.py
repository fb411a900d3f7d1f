"""Plays a recording against another server, or another version of the adapter, and finds where the answers part."""

from __future__ import annotations

import contextlib
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl.client import ClientError, PolicyServerError
from xpl_cli.audit.rules.fingerprint import fingerprint
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.served import recording as tape
from xpl_cli.audit.served.exact import Mismatch, mismatch
from xpl_cli.audit.served.recording import DamagedError
from xpl_cli.basics.errors import ExitCode, UserError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl import Client
    from xpl.wire import codec
    from xpl_cli.audit.replay.counterparts import Counterpart
    from xpl_cli.audit.served.recording import Recording
    from xpl_cli.basics.progress import Progress

_WISHES = frozenset((sdk.Capability.PACKED, sdk.Capability.SHARED_MEMORY, sdk.Capability.JPEG, "pipelined"))
_TOLD = 25
"""Frames between two signs of life."""


@dataclass(frozen=True)
class Difference:
    """The first answer that was another one.

    Attributes:
        frame: number of the request in the recording, counted from 1.
        method: what was asked.
        session, episode: of which client, and in which of its episodes, counted from 1.
        observation: number of the frame that showed the last observation before it, or None.
        env_idx: the environment; None where the answer is not about one.
        step, key, element: place in the chunk: action step, key, element of the array; None where it differs above.
        recorded, replayed: the two values there, or what they are.
        size: distance of two numbers.
    """

    frame: int
    method: str
    session: int
    episode: int
    observation: int | None
    env_idx: int | None
    step: int | None
    key: str | None
    element: list[int] | None
    recorded: Any
    replayed: Any
    size: float | None

    def __str__(self) -> str:
        key = None if self.key is None else self.key + "".join(f"[{index}]" for index in self.element or ())
        place = [f"frame {self.frame}", self.method]
        place += [
            f"{word} {value}"
            for word, value in (("environment", self.env_idx), ("step", self.step))
            if value is not None
        ]
        apart = "" if self.size is None else f" (apart by {self.size:.6g})"
        return f"{', '.join(place + ([key] if key else []))}: {self.recorded} recorded, {self.replayed} replayed{apart}"


@dataclass
class Replay:
    """What became of playing one recording.

    Attributes:
        recording: its folder.
        against: what it was played against.
        tolerance: distance of numbers up to which they counted as equal; 0 compares bits.
        frames: frames that were played.
        compared: answers that were compared.
        skipped: frames of servers that what it was played against does not offer.
        difference: the first one, after which nothing more is played; None if there is none.
        remarks: what has to be known to judge the result.
    """

    recording: str
    against: str
    tolerance: float
    frames: int = 0
    compared: int = 0
    skipped: int = 0
    difference: Difference | None = None
    remarks: list[str] = field(default_factory=list)

    def document(self) -> dict[str, Any]:
        """Return the entry of a `xpl.replay/1` report."""
        return {**asdict(self), "equal": self.difference is None}


def replay(recorded: Recording, against: Counterpart, tolerance: float, progress: Progress) -> Replay:
    """Play a recording up to the first answer that differs.

    Args:
        recorded: the recording.
        against: what is asked instead.
        tolerance: distance up to which numbers count as equal; 0 compares bits.
        progress: told how far it is.

    Raises:
        DamagedError: if a frame makes no sense.
        UserError: if the server cannot be started or reached.
    """
    result = Replay(str(recorded.folder), against.name, tolerance, remarks=_remarks(recorded))
    progress.step(f"{recorded.folder.name}: {recorded.frames} frames against {against.name}")
    with contextlib.closing(_Player(recorded, against, result)) as player:
        for number, frame in enumerate(recorded, 1):
            if number % _TOLD == 0:
                progress.detail(f"{recorded.folder.name}: frame {number} of {recorded.frames}")
            result.frames = number
            player.play(number, frame)
            if result.difference is not None:
                return result
        if player.open_questions:
            result.remarks.append(
                f"{player.open_questions} of the last requests have no recorded answer to compare with"
            )
        relayed = player.relayed
    if result.skipped > relayed:
        result.remarks.append(
            f"{result.skipped - relayed} frames are of servers with other settings than the one at {against.name}, and "
            "were not played: --policy plays all"
        )
    if relayed:
        result.remarks.append(f"{relayed} frames went through a relay that cut connections, and were not played")
    return result


def _remarks(recorded: Recording) -> list[str]:
    index, remarks = recorded.index, []
    if not index["policy"]["manifest"].get("deterministic", True):
        remarks.append("the recorded policy is declared not deterministic: a difference may be chance")
    here = fingerprint(Gate(index["gate"]))
    if index["fingerprint"] != here:
        remarks.append(
            f"recorded under fingerprint {index['fingerprint']}, played under {here}: other versions or another "
            "processor may round differently"
        )
    if recorded.torn:
        remarks.append("the recording breaks off: the audit that made it was ended")
    return remarks


@dataclass
class _Talk:
    """One client of the recording, and its counterpart.

    Attributes:
        client: the counterpart.
        number: which of the recording's clients it is.
        episode: how often it has reset.
        observation: frame of the last observation.
        envs: environments of the last observation, in its order.
        given: answers that are still to be compared, by the id of their request.
    """

    client: Client
    number: int
    episode: int = 0
    observation: int | None = None
    envs: list[int | None] = field(default_factory=list)
    given: dict[str, _Given] = field(default_factory=dict)


@dataclass(frozen=True)
class _Given:
    """What was answered to a request now, and what the request was."""

    frame: int
    method: str
    envs: list[int | None]
    answer: Any


class _Player:
    """Asks what was asked, in the recorded order, and compares.

    Attributes:
        relayed: frames of clients that reached a server by a way that is not part of the recording.
    """

    def __init__(self, recorded: Recording, against: Counterpart, result: Replay) -> None:
        self._path = recorded.folder / tape.FRAMES
        self._against = against
        self._result = result
        self._servers: dict[str, tuple[contextlib.ExitStack, str]] = {}
        self._talks: dict[str, _Talk] = {}
        self._refused: set[str] = set()
        self._sessions = 0
        self.relayed = 0

    @property
    def open_questions(self) -> int:
        """How many requests have no recorded answer."""
        return sum(len(talk.given) for talk in self._talks.values())

    def close(self) -> None:
        """End every client and server."""
        for talk in self._talks.values():
            talk.client.close()
        with contextlib.ExitStack() as stack:
            for server, _ in self._servers.values():
                stack.push(server)

    def play(self, number: int, frame: codec.Frame) -> None:
        """Do what one frame says."""
        try:
            self._play(number, frame)
        except (LookupError, TypeError, AttributeError) as error:
            raise DamagedError(self._path, f"frame {number} makes no sense: {type(error).__name__} {error}") from None

    def _play(self, number: int, frame: codec.Frame) -> None:
        kind, name = frame.message_type, frame.trial_id or ""
        self._sessions += kind == tape.SESSION
        if kind == tape.SERVER:
            self._start(frame)
        elif frame.evaluation_id not in self._servers:
            self._result.skipped += 1
            self.relayed += frame.evaluation_id not in self._refused
        elif kind == tape.SERVER_END:
            self._servers.pop(frame.evaluation_id)[0].close()
        elif kind == tape.SESSION:
            self._connect(frame, name)
        elif kind == tape.SESSION_END:
            self._talks.pop(name).client.close()
        elif (request := tape.asked(frame)) is not None:
            talk = self._talks[name]
            talk.given[frame.message_id] = self._ask(talk, number, *request)
        else:
            self._compare(self._talks[name], frame)

    def _start(self, frame: codec.Frame) -> None:
        offered = self._against.server(frame.payload[tape.OVERRIDES], frame.payload[tape.SERVED])
        if offered is None:
            self._refused.add(frame.evaluation_id)
            self._result.skipped += 1
            return
        with contextlib.ExitStack() as stack:
            url = stack.enter_context(offered)
            self._servers[frame.evaluation_id] = (stack.pop_all(), url)

    def _connect(self, frame: codec.Frame, name: str) -> None:
        wishes = frame.payload[tape.WISHES]
        if unknown := set(wishes) - _WISHES:
            raise LookupError(f"a client has no option {min(unknown)!r}")
        try:
            client = self._against.client(self._servers[frame.evaluation_id][1], wishes)
        except ClientError as error:
            raise UserError(str(error), code=ExitCode.NOT_RUN) from None
        self._talks[name] = _Talk(client, self._sessions)

    def _ask(self, talk: _Talk, number: int, method: str, obs: Any) -> _Given:
        envs = talk.envs
        if method in (sdk.Method.UPDATE_OBS, sdk.Method.UPDATE_OBS_BATCH, sdk.Method.INFER):
            shown = obs if method == sdk.Method.UPDATE_OBS_BATCH else [obs]
            envs = talk.envs = [one.get(sdk.Obs.ENV_IDX) if isinstance(one, dict) else None for one in shown]
            talk.observation = number
        elif method == sdk.Method.RESET:
            talk.episode, talk.observation, talk.envs = talk.episode + 1, None, []
        elif method == sdk.Method.GET_ACTION_BATCH and obs is not None:
            envs = list(obs)
        try:
            answer = talk.client.infer(obs) if method == sdk.Method.INFER else talk.client.call(method, obs)
        except ClientError as error:
            answer = error
        return _Given(number, method, envs, answer)

    def _compare(self, talk: _Talk, frame: codec.Frame) -> None:
        given = talk.given.pop(frame.message_id)
        self._result.compared += 1
        failed = frame.message_type in (sdk.Message.ERROR, tape.CUT)
        if failed or isinstance(given.answer, ClientError):
            expected = _failure(frame.payload) if failed else "an answer"
            # Texts of errors may hold addresses and paths.
            same = (
                isinstance(given.answer, ClientError)
                and failed
                and _code(given.answer) == frame.payload.get(sdk.Payload.CODE)
            )
            found = None if same else Mismatch((), expected, _replayed(given.answer))
        else:
            (recorded,) = frame.payload.values()
            found = mismatch(recorded, given.answer, self._result.tolerance)
        if found is not None:
            self._result.difference = _located(talk, given, found)


def _code(error: ClientError) -> str | None:
    return error.code if isinstance(error, PolicyServerError) else None


def _failure(payload: Mapping[str, Any]) -> str:
    code = payload.get(sdk.Payload.CODE)
    return f"{'no answer' if code is None else f'an error ({code})'}: {payload.get(sdk.Payload.MESSAGE)!s:.200}"


def _replayed(answer: Any) -> str:
    if not isinstance(answer, ClientError):
        return "an answer"
    code = _code(answer)
    return f"{'no answer' if code is None else f'an error ({code})'}: {answer!s:.200}"


def _located(talk: _Talk, given: _Given, found: Mismatch) -> Difference:
    """Return a difference with its place in words of the contract."""
    path, env = list(found.path), given.envs[0] if len(given.envs) == 1 else None
    if given.method == sdk.Method.GET_ACTION_BATCH and path:
        place = int(path.pop(0))
        env = given.envs[place] if place < len(given.envs) else None
    step = int(path.pop(0)) if path and isinstance(path[0], int) else None
    names = [str(part) for part in path if isinstance(part, str)]
    element = [part for part in path if isinstance(part, int)]
    return Difference(
        frame=given.frame,
        method=given.method,
        session=talk.number,
        episode=talk.episode,
        observation=talk.observation,
        env_idx=env,
        step=step,
        key=".".join(names) or None,
        element=element or None,
        recorded=found.first,
        replayed=found.second,
        size=found.size,
    )
