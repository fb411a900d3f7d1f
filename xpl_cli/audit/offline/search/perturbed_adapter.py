"""An adapter's answers where what it is shown, or what it commands, is changed around it."""

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
    """Plays mistakes on a served adapter. Mistakes that show the same share one play.

    Args:
        course: the questions.
        given: the adapter's own answers to all of them.
        connect: yields a client of a model that was just built; None where nothing is to be shown.
        once: connect once, since a reset makes the model forget.
        together: play as the whole session does, all environments together and each episode in its turn; else each
            episode of an environment by itself.
    """

    def __init__(
        self,
        course: SessionReplay,
        given: Mapping[int, Sequence[Any]],
        connect: Callable[[], AbstractContextManager[Client]] | None = None,
        *,
        once: bool = True,
        together: bool = False,
    ) -> None:
        self._course = course
        self._given = given
        self._connect = connect
        self._once = once
        self._together = together
        self._opened = ExitStack()
        self._client: Client | None = None
        self._plays: dict[tuple[int, tuple[int, ...]], Mapping[int, Sequence[Any]] | None] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def answers(self, mistake: Mistake, wanted: Sequence[int]) -> dict[int, list[Any]] | None:
        """Return the answers to some questions, and those before them, with a change; None if it is refused.

        A step that the change cannot tell is None.
        """
        numbers = self._course.with_earlier(wanted)
        given = self._answers_to_changed_observations(mistake, numbers)
        if given is None or mistake.change_actions is None:
            return None if given is None else {number: list(chunk) for number, chunk in given.items()}
        found: dict[int, list[Any]] = {}
        for episode in self._course.group_by_episode(numbers):
            questions = [self._course.session.questions[number] for number in episode]
            places = [question.asked_at[-1] for question in questions]
            told = [given[number] for number in episode]
            try:
                changed = mistake.change_actions(told, self._course.observations_of(questions[-1]), places)
            except ValueError:  # such as a rotation of length zero
                return None
            found.update(zip(episode, changed, strict=True))
        return found

    def _answers_to_changed_observations(
        self, mistake: Mistake, numbers: Sequence[int]
    ) -> Mapping[int, Sequence[Any]] | None:
        if mistake.change_observations is None:
            return {number: self._given[number] for number in numbers}
        if self._connect is None:
            return None
        key = (id(mistake.change_observations), tuple(numbers))
        if key not in self._plays:
            try:
                play = self._replay_together if self._together else self._replay_by_episode
                self._plays[key] = play(self._connected(), mistake, numbers)
            except QuestionRefusedError:
                self._plays[key] = None
        return self._plays[key]

    def _connected(self) -> Client:
        """Return the client for one play."""
        assert self._connect is not None  # noqa: S101 - see who asks
        if self._client is None or not self._once:
            self._opened.close()
            self._client = self._opened.enter_context(self._connect())
        return self._client

    def _replay_together(self, client: Client, mistake: Mistake, numbers: Sequence[int]) -> dict[int, Chunk]:
        """Play all episodes in their order, each with its environments together."""
        assert mistake.change_observations is not None  # noqa: S101 - see who asks
        session = self._course.session
        changed: dict[tuple[int, int], Observation] = {}
        for episode in self._course.group_by_episode(numbers):
            last = session.questions[episode[-1]]
            changed.update(
                zip(last.recipes, mistake.change_observations(self._course.observations_of(last)), strict=True)
            )

        def observation(env: int, place: int) -> Observation:
            return changed.get((env, place)) or self._course.observation(env, place)

        asked = [session.questions[number] for number in numbers]
        return replay_by_question(client, session, self._course.calls_for(numbers), asked, observation)

    def _replay_by_episode(self, client: Client, mistake: Mistake, numbers: Sequence[int]) -> dict[int, Chunk]:
        assert mistake.change_observations is not None  # noqa: S101 - see who asks
        found: dict[int, Chunk] = {}
        for episode in self._course.group_by_episode(numbers):
            questions = [self._course.session.questions[number] for number in episode]
            if mistake.windowed:
                for question in questions:
                    shown = mistake.change_observations(self._course.observations_of(question))
                    found.update(self._run_episode(client, shown, {len(shown) - 1: question}))
            else:
                shown = mistake.change_observations(self._course.observations_of(questions[-1]))
                found.update(
                    self._run_episode(client, shown, {question.asked_at[-1]: question for question in questions})
                )
        return found

    def _run_episode(
        self, client: Client, shown: Sequence[Observation], asked: Mapping[int, PairQuestion]
    ) -> dict[int, Chunk]:
        """Play one episode, and return its answers by the numbers of the questions."""
        client.reset()
        found = {}
        for place, observation in enumerate(shown):
            question = asked.get(place)
            if question is not None:
                found[question.number] = check_answer(client.infer(observation), question, self._course.session)
                continue
            told = client.update_obs(observation)
            if isinstance(told, PolicyServerError):
                raise QuestionRefusedError(next(iter(asked.values())), told)
        return found
