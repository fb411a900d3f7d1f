"""Replays sessions on a served adapter, to get its actions for their questions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl.action import ActionError, check_chunk
from xpl.client import PolicyServerError

if TYPE_CHECKING:
    from xpl_cli.audit.served.recorded_client import Answer
    from xpl_cli.audit.served.recorded_client import RecordedClient as Client
    from xpl_cli.model_io.pairs import Chunk, PairQuestion, PairSession
    from xpl_cli.model_io.script import Call

Observation = Mapping[str, Any]


class QuestionRefusedError(Exception):
    """The adapter answers a question with an error, or with something that is not an action chunk."""

    def __init__(self, question: PairQuestion, answer: object) -> None:
        super().__init__(str(answer))
        self.question = question
        self.answer = answer


def overrides(session: PairSession, settings: Mapping[str, object]) -> dict[str, object]:
    """Return the keys of deploy.yml that an adapter is served with for a session."""
    return {
        **settings,
        sdk.Deploy.ENV_CFG_TYPE: session.embodiment,
        sdk.Deploy.ACTION_TYPE: session.action_type,
        sdk.Deploy.SEED: session.seed,
    }


def replay_session(client: Client, session: PairSession) -> list[list[Chunk]]:
    """Return the answers to all questions of a session, with as many takes as the session has.

    One environment uses `update_obs` and `get_action`, several use the batch methods, as clients do.

    Raises:
        RefusedError: if an answer is an error or no chunk.
    """
    return replay_calls(client, session, session.calls, session.questions, session.scene.observation)


def replay_calls(
    client: Client,
    session: PairSession,
    calls: Sequence[Call],
    asked_questions: Sequence[PairQuestion],
    observation: Callable[[int, int], Observation],
) -> list[list[Chunk]]:
    """Return the answers to the questions of some calls.

    Args:
        client: of the adapter.
        session: of the calls.
        calls: some calls of the session.
        asked_questions: the questions of these calls, in order.
        observation: returns the observation of an environment and an index.

    Raises:
        RefusedError: if an answer is an error or no chunk.
    """
    pending: Iterator[PairQuestion] = iter(asked_questions)
    answers: list[list[Chunk]] = []
    last_observed: tuple[int, ...] = ()
    for call in calls:
        if call.reset:
            client.reset()
        elif call.show:
            last_observed = tuple(env for env, _ in call.show)
            observations = [observation(env, index) for env, index in call.show]
            answer = (
                client.update_obs(observations[0]) if len(last_observed) == 1 else client.update_obs_batch(observations)
            )
            if isinstance(answer, PolicyServerError):
                raise QuestionRefusedError(next(pending), answer)
        else:
            batch = [next(pending) for _ in call.ask]
            takes = [_get_chunks(client, session, batch, alone=call.ask == last_observed) for _ in range(session.takes)]
            answers += [list(chunks) for chunks in zip(*takes, strict=True)]
    return answers


def replay_by_question(
    client: Client,
    session: PairSession,
    calls: Sequence[Call],
    questions: Sequence[PairQuestion],
    observation: Callable[[int, int], Observation],
) -> dict[int, Chunk]:
    """Return the first takes of `replay_calls` by question number."""
    answers = replay_calls(client, session, calls, questions, observation)
    return {question.number: takes[0] for question, takes in zip(questions, answers, strict=True)}


def _get_chunks(client: Client, session: PairSession, questions: Sequence[PairQuestion], *, alone: bool) -> list[Chunk]:
    if len(questions) == 1 and alone:
        return [check_answer(client.get_action(), questions[0], session)]
    answer = client.get_action_batch([question.env for question in questions])
    if isinstance(answer, PolicyServerError) or not isinstance(answer, (list, tuple)) or len(answer) != len(questions):
        raise QuestionRefusedError(questions[0], answer)
    return [check_answer(chunk, question, session) for chunk, question in zip(answer, questions, strict=True)]


def check_answer(chunk: Answer, question: PairQuestion, session: PairSession) -> Chunk:
    """Return an answer as a list of action steps.

    Raises:
        RefusedError: if it is none.
    """
    if isinstance(chunk, PolicyServerError):
        raise QuestionRefusedError(question, chunk)
    try:
        check_chunk(chunk, session.robot, session.action_type)
    except ActionError as error:
        raise QuestionRefusedError(question, error) from None
    steps: Chunk = list(chunk)
    return steps
