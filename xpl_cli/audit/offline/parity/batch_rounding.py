"""What batches round: an answer that is off by little, because it was given in a batch.

reference.py answers one question at a time, an adapter some in batches, and a GPU sums batches in another order. In
LeRobot's Diffusion Policy on an H100 one of 20 answers was 0.4 % of a span off. Rounding is gone where an environment
is asked by itself, and stays as it is whatever the others of the batch show; what is mixed up or kept does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli.audit.offline.search.replay import QuestionRefusedError, replay_by_question
from xpl_cli.audit.offline.search.session_replay import SessionReplay
from xpl_cli.audit.served.rounding import OF_SPAN

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager

    from xpl.contract import ObservationDict
    from xpl_cli.audit.offline.parity.judgement import Judgement
    from xpl_cli.audit.served.recorded_client import RecordedClient as Client
    from xpl_cli.model_io.pairs import Chunk

    Serving = Callable[[], AbstractContextManager[Client]]
    """Connects to a new server of the adapter."""


def unbatched_answers(judged: Judgement, serving: Serving) -> dict[int, Chunk]:
    """Return the answers of environments by themselves, where those of batches differ from the golden ones by rounding.

    Args:
        judged: a session with one take of each question.
        serving: of the adapter.

    Returns:
        By the question's number, for all whose answers differ; empty if any of them differs for another reason, or by
        more than batches round.
    """
    off = [question for question, differs in zip(judged.session.questions, judged.differs, strict=True) if differs]
    if not off or max(judged.shares.values()) > OF_SPAN:
        return {}
    course, found = SessionReplay(judged.session), {}
    for env in sorted({question.env for question in off}):
        try:
            alone, among_others = _answers_alone(course, env, serving), _answers_among_copies(course, env, serving)
        except QuestionRefusedError:
            return {}
        for number in (question.number for question in off if question.env == env):
            if judged.differ(judged.answers[number], among_others[number]):
                return {}
            if judged.differ(judged.golden[number], alone[number]):
                return {}
            found[number] = alone[number]
    return found


def _answers_alone(course: SessionReplay, env: int, serving: Serving) -> dict[int, Chunk]:
    """Return the answers to all questions of an environment that nothing is beside."""
    own = [question for question in course.session.questions if question.env == env]
    calls = course.calls_for([question.number for question in own])
    with serving() as client:
        return replay_by_question(client, course.session, calls, own, course.observation)


def _answers_among_copies(course: SessionReplay, env: int, serving: Serving) -> dict[int, Chunk]:
    """Return the answers to all questions where every environment shows what this one does at its places."""
    session = course.session

    def observation(other: int, place: int) -> ObservationDict:
        return {**course.observation(env, place), sdk.Obs.ENV_IDX: other}

    with serving() as client:
        return replay_by_question(client, session, session.calls, session.questions, observation)
