"""A served adapter whose observations or actions are perturbed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Self

from xpl.client import PolicyServerError
from xpl_cli.audit.offline.search.replay import QuestionRefusedError, check_answer, replay_by_question

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager

    from xpl.catalogue import Mistake
    from xpl.contract import Observation
    from xpl_cli.audit.offline.search.session_replay import SessionReplay
    from xpl_cli.audit.served.recorded_client import RecordedClient as Client
    from xpl_cli.model_io.pairs import Chunk, PairQuestion


class PerturbedAdapter:
    """Replays a session under mistakes. Mistakes with the same change of observations share one replay.

    Args:
        replay: the session.
        answers: the adapter's own answers to all questions.
        connect: yields a client of a model that was just built; None where observations are not changed.
        once: whether to connect only once, since a reset makes the model forget.
        together: whether all environments run together, as in the session; else each episode of an environment runs
            alone.
    """

    def __init__(
        self,
        replay: SessionReplay,
        answers: Mapping[int, Sequence[Any]],
        connect: Callable[[], AbstractContextManager[Client]] | None = None,
        *,
        once: bool = True,
        together: bool = False,
    ) -> None:
        self._replay = replay
        self._answers = answers
        self._connect = connect
        self._once = once
        self._together = together
        self._exit_stack = ExitStack()
        self._client: Client | None = None
        self._results: dict[tuple[int, tuple[int, ...]], Mapping[int, Sequence[Any]] | None] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._exit_stack.close()

    def answers(self, mistake: Mistake, question_numbers: Sequence[int]) -> dict[int, list[Any]] | None:
        """Return the answers under a mistake to some questions and the earlier ones; None if the adapter refuses.

        Steps that the change does not determine are None.
        """
        numbers = self._replay.with_earlier(question_numbers)
        answers = self._answers_to_changed_observations(mistake, numbers)
        if answers is None or mistake.change_actions is None:
            return None if answers is None else {number: list(chunk) for number, chunk in answers.items()}
        changed_answers: dict[int, list[Any]] = {}
        for episode in self._replay.group_by_episode(numbers):
            questions = [self._replay.session.questions[number] for number in episode]
            steps = [question.asked_at[-1] for question in questions]
            chunks = [answers[number] for number in episode]
            try:
                changed = mistake.change_actions(chunks, self._replay.observations_of(questions[-1]), steps)
            except ValueError:  # such as a rotation of length zero
                return None
            changed_answers.update(zip(episode, changed, strict=True))
        return changed_answers

    def _answers_to_changed_observations(
        self, mistake: Mistake, numbers: Sequence[int]
    ) -> Mapping[int, Sequence[Any]] | None:
        if mistake.change_observations is None:
            return {number: self._answers[number] for number in numbers}
        if self._connect is None:
            return None
        key = (id(mistake.change_observations), tuple(numbers))
        if key not in self._results:
            try:
                play = self._replay_together if self._together else self._replay_by_episode
                self._results[key] = play(self._connected(), mistake, numbers)
            except QuestionRefusedError:
                self._results[key] = None
        return self._results[key]

    def _connected(self) -> Client:
        """Return a client for one replay."""
        assert self._connect is not None  # noqa: S101 - see who asks
        if self._client is None or not self._once:
            self._exit_stack.close()
            self._client = self._exit_stack.enter_context(self._connect())
        return self._client

    def _replay_together(self, client: Client, mistake: Mistake, numbers: Sequence[int]) -> dict[int, Chunk]:
        """Replay all episodes in order, with all environments together."""
        assert mistake.change_observations is not None  # noqa: S101 - see who asks
        session = self._replay.session
        changed: dict[tuple[int, int], Observation] = {}
        for episode in self._replay.group_by_episode(numbers):
            last = session.questions[episode[-1]]
            changed.update(
                zip(last.recipes, mistake.change_observations(self._replay.observations_of(last)), strict=True)
            )

        def observation(env: int, index: int) -> Observation:
            return changed.get((env, index)) or self._replay.observation(env, index)

        questions = [session.questions[number] for number in numbers]
        return replay_by_question(client, session, self._replay.calls_for(numbers), questions, observation)

    def _replay_by_episode(self, client: Client, mistake: Mistake, numbers: Sequence[int]) -> dict[int, Chunk]:
        assert mistake.change_observations is not None  # noqa: S101 - see who asks
        answers: dict[int, Chunk] = {}
        for episode in self._replay.group_by_episode(numbers):
            questions = [self._replay.session.questions[number] for number in episode]
            if mistake.windowed:
                for question in questions:
                    observations = mistake.change_observations(self._replay.observations_of(question))
                    answers.update(self._run_episode(client, observations, {len(observations) - 1: question}))
            else:
                observations = mistake.change_observations(self._replay.observations_of(questions[-1]))
                answers.update(
                    self._run_episode(client, observations, {question.asked_at[-1]: question for question in questions})
                )
        return answers

    def _run_episode(
        self, client: Client, observations: Sequence[Observation], questions: Mapping[int, PairQuestion]
    ) -> dict[int, Chunk]:
        """Run one episode, and return its answers by question number."""
        client.reset()
        answers = {}
        for step, observation in enumerate(observations):
            question = questions.get(step)
            if question is not None:
                answers[question.number] = check_answer(client.infer(observation), question, self._replay.session)
                continue
            answer = client.update_obs(observation)
            if isinstance(answer, PolicyServerError):
                raise QuestionRefusedError(next(iter(questions.values())), answer)
        return answers
