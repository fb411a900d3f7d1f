"""A client whose answers are recorded, for experiments of rules.

All requests and answers of an audit pass through `AnswerRecorder`, which hashes the answers for the digest.
"""

from __future__ import annotations

import hashlib
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl.client import PolicyServerError
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.audit.rules.time_limit import TimeLimit
from xpl_cli.audit.served.compare import error_code
from xpl_cli.audit.served.serving_choice import describe_missing
from xpl_cli.serving.launch import MissingRequirement
from xpl_cli.serving.workers.worker_answers import RAISED_AT, Frame, parse_frames

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from xpl import Client
    from xpl.contract import Config, Observation

_MOST_ERRORS = 64
Answer = Any
"""An answer of a policy: a chunk, a list of chunks, None, or a `PolicyServerError` in place of them.

It is not validated: check it with `compare.is_answer_list` before reading values."""


@dataclass(frozen=True)
class RaisedError:
    """An exception of the adapter.

    Attributes:
        text: its message, as clients get it.
        code: the wire's code of the answer; empty if there was none.
        frames: frames of the adapter's own files, innermost first: file, line and function.
    """

    text: str
    code: str
    frames: tuple[Frame, ...]


class AnswerRecorder:
    """Hashes requests of an audit and the answers of servers, and notes where the adapter raised.

    Args:
        clock: stops a rule when the time of the audit is over.

    Attributes:
        last: the operation that was requested last.
        errors: the latest exceptions of the adapter, in the order of their answers.
        recent: those of the rule that runs.
    """

    def __init__(self, clock: TimeLimit | None = None) -> None:
        self._clock = clock or TimeLimit()
        self.last = ""
        self.errors: deque[RaisedError] = deque(maxlen=_MOST_ERRORS)
        self.recent: list[RaisedError] = []
        self._hash = hashlib.sha256()

    def request(self, name: str, ask: Callable[[], Answer]) -> Answer:
        """Send a request, and return the answer or the policy's error.

        Args:
            name: the operation.
            ask: does it.

        Raises:
            ClientError: if no answer came.
            NotRun: if the machine lacks something that the answer needs, or the audit's time is over.
        """
        self._clock.check()
        self.last = name
        try:
            answer = ask()
        except PolicyServerError as error:
            answer = error
            self.note(str(error).removeprefix(f"{error.code}: "), error.code, error.details.get(RAISED_AT))
        self._hash.update(name.encode())
        # Texts of errors may hold addresses and paths, so only the code is hashed.
        self._add_to_hash(error_code(answer) if isinstance(answer, PolicyServerError) else answer)
        if isinstance(answer, PolicyServerError) and (lacks := MissingRequirement.parse(answer.details.get("lacks"))):
            raise NotRun(describe_missing(lacks))
        return answer

    def note(self, text: str, code: str, frames: object) -> None:
        """Note an exception of the adapter, if it went through its own files."""
        if own := parse_frames(frames):
            self.errors.append(RaisedError(text, code, own))
            self.recent = [*self.recent[-_MOST_ERRORS:], self.errors[-1]]

    def record(self) -> str:
        """Return the hash of everything so far."""
        return self._hash.hexdigest()[:16]

    def _add_to_hash(self, value: object) -> None:
        """Add a value to the hash. Arrays count by dtype, shape and bytes."""
        import numpy as np

        if isinstance(value, dict):
            for key in sorted(value):
                self._hash.update(str(key).encode())
                self._add_to_hash(value[key])
        elif isinstance(value, (list, tuple)):
            self._hash.update(f"[{len(value)}".encode())
            for item in value:
                self._add_to_hash(item)
        elif isinstance(value, (np.ndarray, np.generic)):
            array = np.asarray(value)
            self._hash.update(f"{array.dtype.str}{array.shape}".encode())
            self._hash.update(array.tobytes())
        else:
            self._hash.update(repr(value).encode())


class RecordedClient:
    """A client whose answers are recorded. Errors of the policy are returned, not raised."""

    def __init__(self, client: Client, recorder: AnswerRecorder) -> None:
        self._client = client
        self._recorder = recorder

    def reset(self) -> Answer:
        """Start an episode."""
        return self.call(sdk.Method.RESET)

    def update_obs(self, obs: object) -> Answer:
        """Send one observation."""
        return self.call(sdk.Method.UPDATE_OBS, obs)

    def update_obs_batch(self, obs_list: Sequence[object]) -> Answer:
        """Send observations of several environments."""
        return self.call(sdk.Method.UPDATE_OBS_BATCH, list(obs_list))

    def get_action(self) -> Answer:
        """Get a chunk."""
        return self.call(sdk.Method.GET_ACTION)

    def get_action_batch(self, env_idx_list: Sequence[int] | None = None) -> Answer:
        """Get the chunks of some environments."""
        return self.call(sdk.Method.GET_ACTION_BATCH, None if env_idx_list is None else list(env_idx_list))

    def infer(self, obs: Observation) -> Answer:
        """Send an observation and get a chunk in one request."""
        return self._recorder.request(sdk.Method.INFER, lambda: self._client.infer(obs))

    def act(self, obs: object) -> Answer:
        """Reset, send one observation and return the chunk, or the first error."""
        reset_answer = self.reset()
        return reset_answer if isinstance(reset_answer, PolicyServerError) else self.act_at_once(obs)

    def act_at_once(self, obs: object) -> Answer:
        """Send one observation and return the chunk, without a reset."""
        update_answer = self.update_obs(obs)
        return update_answer if isinstance(update_answer, PolicyServerError) else self.get_action()

    def act_batch_at_once(self, observations: Sequence[object], env_idx_list: Sequence[int] | None) -> Answer:
        """Send a batch of observations and return the chunks of some environments, or the first error."""
        update_answer = self.update_obs_batch(observations)
        if isinstance(update_answer, PolicyServerError):
            return update_answer
        return self.get_action_batch(env_idx_list)

    def prepare_case(self, case: Config) -> Answer:
        """Call `prepare_case` with a case; None where the adapter has no such hook."""
        return self._recorder.request(sdk.Message.PREPARE_CASE, lambda: self._client.prepare_case(**case))

    def trial_end(self, result: Config) -> Answer:
        """Call `trial_end` with the result of a trial; None where the adapter has no such hook."""
        return self._recorder.request(sdk.Message.TRIAL_END, lambda: self._client.trial_end(result))

    def call(self, name: str, obs: Any = None) -> Answer:
        """Run any operation of the wire or of the policy."""
        if name == sdk.Message.PREPARE_CASE:
            return self.prepare_case(obs)
        if name == sdk.Message.TRIAL_END:
            return self.trial_end(obs)
        return self._recorder.request(name, lambda: self._client.call(name, obs))
