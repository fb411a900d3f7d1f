"""Replay of a part of a session: some questions, and the observations and resets that come before them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.model_io.script import Call, with_episode_numbers

if TYPE_CHECKING:
    from xpl.contract import ObservationDict
    from xpl_cli.model_io.pairs import PairQuestion, PairSession

EpisodeKey = tuple[int, int]
"""Number of an episode, and an environment."""


def _observation_name(env: int, index: int) -> str:
    return f"{env} {index}"


class SessionReplay:
    """A session of which some questions are asked again. Observations are cached.

    Args:
        session: the session.
    """

    def __init__(self, session: PairSession) -> None:
        self.session = session
        self._made: dict[tuple[int, int], ObservationDict] = {}

    @cached_property
    def all_questions(self) -> list[int]:
        """The numbers of all questions."""
        return [question.number for question in self.session.questions]

    def observation(self, env: int, index: int) -> ObservationDict:
        """Return the observation of a recipe."""
        key = (env, index)
        if key not in self._made:
            self._made[key] = self.session.scene.observation(env, index)
        return self._made[key]

    def observations_of(self, question: PairQuestion) -> list[ObservationDict]:
        """Return the observations of a question's episode up to the question."""
        return [self.observation(env, index) for env, index in question.recipes]

    def group_by_episode(self, numbers: Iterable[int]) -> list[list[int]]:
        """Group questions by episode, in order."""
        episodes: dict[EpisodeKey, list[int]] = {}
        for number in sorted(numbers):
            episodes.setdefault(self._key(number), []).append(number)
        return list(episodes.values())

    def with_earlier(self, numbers: Iterable[int]) -> list[int]:
        """Add the earlier questions of the same episodes, which an adapter may remember."""
        last = self._last(numbers)
        return [number for number in self.all_questions if number <= last.get(self._key(number), -1)]

    def calls_for(self, numbers: Sequence[int]) -> list[Call]:
        """Return the calls that ask some questions, and the calls before them, as in the whole session.

        An episode that is skipped still gets one observation: random numbers of the next one depend on its number.
        """
        questions = self.session.questions
        until = {key: questions[number].call for key, number in self._last(numbers).items()}
        skipped = set(range(max((episode for episode, _ in until), default=0))) - {episode for episode, _ in until}
        calls = []
        for index, (call, episode) in enumerate(with_episode_numbers(self.session.calls)):
            show = tuple(recipe for recipe in call.show if index <= until.get((episode, recipe[0]), -1))
            if call.show and episode in skipped:
                show = call.show
                skipped.remove(episode)
            ask = tuple(env for env in call.ask if index <= until.get((episode, env), -1))
            if call.reset or show or ask:
                calls.append(Call(call.reset, show, ask))
        return calls

    def worker_request(self, calls: Sequence[Call], sent: set[str]) -> dict[str, Any]:
        """Return calls as a request to `xpl.worker.perturbed_answers`, a process in the adapter's interpreter.

        Args:
            calls: of this session.
            sent: names of the observations that the process already has; the new ones are added.
        """
        new = {
            _observation_name(*recipe): recipe
            for call in calls
            for recipe in call.show
            if _observation_name(*recipe) not in sent
        }
        sent.update(new)
        return {
            "observations": {name: self.observation(*recipe) for name, recipe in new.items()},
            "calls": [
                {sdk.Method.RESET: True}
                if call.reset
                else {"ask": list(call.ask)}
                if call.ask
                else {"show": [[env, _observation_name(env, index)] for env, index in call.show]}
                for call in calls
            ],
        }

    def _last(self, numbers: Iterable[int]) -> dict[EpisodeKey, int]:
        """Return the last of some questions in each episode."""
        return {self._key(number): number for number in sorted(numbers)}

    def _key(self, number: int) -> EpisodeKey:
        question = self.session.questions[number]
        return question.episode, question.env
