"""Batch-size-dependent floating-point error: an answer that is slightly off because it was computed in a batch.

reference.py answers one question at a time, an adapter some in batches, and a GPU sums batches in another order. In
LeRobot's Diffusion Policy on an H100, one of 20 answers was off by 0.4 % of the span. Rounding vanishes where an
environment runs alone, and does not depend on the other observations of the batch; an adapter that mixes up
environments or keeps state behaves differently.
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


def unbatched_answers(judgement: Judgement, connect: Serving) -> dict[int, Chunk]:
    """Return the answers of environments that run alone, where the batched answers differ by rounding only.

    Args:
        judgement: a session with one take of each question.
        connect: of the adapter.

    Returns:
        By the question's number, for all whose answers differ; empty if any of them differs for another reason, or by
        more than batches round.
    """
    differing = [
        question for question, differs in zip(judgement.session.questions, judgement.differs, strict=True) if differs
    ]
    if not differing or max(judgement.shares.values()) > OF_SPAN:
        return {}
    replay, answers = SessionReplay(judgement.session), {}
    for env in sorted({question.env for question in differing}):
        try:
            alone, among_others = _answers_alone(replay, env, connect), _answers_among_copies(replay, env, connect)
        except QuestionRefusedError:
            return {}
        for number in (question.number for question in differing if question.env == env):
            if judgement.differ(judgement.answers[number], among_others[number]):
                return {}
            if judgement.differ(judgement.golden[number], alone[number]):
                return {}
            answers[number] = alone[number]
    return answers


def _answers_alone(replay: SessionReplay, env: int, connect: Serving) -> dict[int, Chunk]:
    """Return the answers to all questions of an environment that runs alone."""
    questions = [question for question in replay.session.questions if question.env == env]
    calls = replay.calls_for([question.number for question in questions])
    with connect() as client:
        return replay_by_question(client, replay.session, calls, questions, replay.observation)


def _answers_among_copies(replay: SessionReplay, env: int, connect: Serving) -> dict[int, Chunk]:
    """Return the answers to all questions where every environment gets the observations of this one."""
    session = replay.session

    def observation(env_idx: int, recipe: int) -> ObservationDict:
        return {**replay.observation(env, recipe), sdk.Obs.ENV_IDX: env_idx}

    with connect() as client:
        return replay_by_question(client, session, session.calls, session.questions, observation)
