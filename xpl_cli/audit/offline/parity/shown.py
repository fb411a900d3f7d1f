"""Which change of what an adapter is shown explains how its answers differ.

It is played again on a server: each episode of an environment by itself, in one connection, if it answers as before
then. If it does not, since it draws, or environments see each other, then all together as in the recording, by a model
that was just built.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl.catalogue import Mistake
from xpl.catalogue.pictures import dark
from xpl_cli.audit.offline.parity.golden import GoldenRuler
from xpl_cli.audit.offline.search.around import Around
from xpl_cli.audit.offline.search.contest import Family, held
from xpl_cli.audit.served.rounding import OF_SPAN
from xpl_cli.model_io.difference import differences
from xpl_cli.model_io.explain import Explanation, Tried
from xpl_cli.model_io.patterns import Pattern

if TYPE_CHECKING:
    from xpl.contract import Observation, ObservationDict
    from xpl_cli.audit.offline.parity.judgement import Judgement
    from xpl_cli.audit.offline.search.contest import Held
    from xpl_cli.audit.offline.search.course import Course
    from xpl_cli.audit.offline.search.ways import Ways
    from xpl_cli.audit.served.probe import Probe

Answers = Mapping[int, Sequence[Any]]

_SAME: Final = Mistake(
    0, "each environment asked by itself", "recurrent", shown=lambda seen: [dict(obs) for obs in seen]
)
"""Changes nothing of what is shown."""
_FIRSTS: Final = 4
"""Mistakes that are undone so that others are tried besides."""


class Shown:
    """The search among changes of what is shown.

    Args:
        probe: the adapter.
        course: the questions.
        judgement: of its answers; something differs.
        config: keys of deploy.yml.
        repeats: whether a reset makes the model forget all, as far as its manifest says.
    """

    def __init__(
        self, probe: Probe, course: Course, judgement: Judgement, config: Mapping[str, object], *, repeats: bool
    ) -> None:
        self._probe, self._course, self._judgement = probe, course, judgement
        self._config, self._repeats = config, repeats
        self.patterns: list[Pattern] = []
        """What was seen besides."""

    def explained(self, mistakes: Sequence[Mistake], ways: Ways, until: float) -> Explanation | None:
        """Return what mistakes explain; None if nothing can be said so.

        Args:
            mistakes: as changes of what is shown.
            ways: of the adapter.
            until: when to end, by the monotonic clock.
        """
        numbers = self._replayable
        ruler = GoldenRuler(self._course, self._judgement, numbers)
        alone: Explanation | None = None
        if ruler.differs:
            with self._around(together=False) as around:
                apart = around.answers(_SAME, numbers)
                if self._is_as_before(apart, numbers):
                    fit = [one for one in mistakes if not one.windowed or self._repeats]
                    found = self._held(fit, around, ruler, ways)
                    if found.cause is None and time.monotonic() < until:
                        self.patterns += self._cameras_without_effect(around, ways.case.cameras)
                    return found
                alone = ruler.explained([Tried(_SAME.words, _SAME.convention, ruler.remaining(apart))])
                if alone.cause is not None:
                    crossed = self._crossed(around, numbers)
                    return ruler.explained([crossed(ruler.remaining(apart))]) if crossed else alone
        return self._all_together([one for one in mistakes if not one.windowed], ways) or alone

    def _all_together(self, mistakes: Sequence[Mistake], ways: Ways) -> Explanation | None:
        everything = self._course.everything
        with self._around(together=True) as around:
            if not self._is_as_before(around.answers(_SAME, everything), everything):
                self.patterns.append(
                    Pattern("the same questions, asked once more, have other answers: look at the seed", "sampling")
                )
                return None
            return self._held(mistakes, around, GoldenRuler(self._course, self._judgement, everything), ways)

    def _held(self, mistakes: Sequence[Mistake], around: Around, ruler: GoldenRuler, ways: Ways) -> Explanation:
        """Return what mistakes explain, one by one; where none does, with a change of commands besides."""
        tried = held(Family(mistakes, ways.asking(around, mistakes, ruler.leaves_nothing)), ruler)
        found = ruler.explained_by(tried)
        if found.cause is not None:
            return found
        is_large = max(ruler.before.values()) > OF_SPAN
        return (self._besides(mistakes, tried, around, ruler, ways) if is_large else None) or found

    def _besides(
        self, mistakes: Sequence[Mistake], tried: Held, around: Around, ruler: GoldenRuler, ways: Ways
    ) -> Explanation | None:
        """Return what explains the difference by two mistakes: of what is shown, and another one."""
        ways.halve()
        for place in ruler.eased(tried.first, _FIRSTS):
            given = around.answers(mistakes[place], ruler.everything) if ways.left > 0 else None
            if given is None:
                continue
            first = tried.first[place]
            last = held(ways.commands(given, ruler.leaves_nothing), ruler).last
            found = ruler.explained([ruler.both(first, one, one.given) for _, one in last])
            if found.cause is not None:
                return found
        return None

    def _crossed(self, apart: Around, numbers: Sequence[int]) -> Callable[[Mapping[str, float]], Tried] | None:
        """Return what to say if environments see only one input of each other: alike in all, it makes no difference."""
        first = self._course.observation(*self._judgement.session.questions[0].shown[0])
        for words, convention, keys in (
            ("each environment's own instruction", sdk.Obs.INSTRUCTION, (sdk.Obs.INSTRUCTION, sdk.Obs.INSTRUCTIONS)),
            ("each environment's own pictures", "camera", (sdk.Obs.VISION,)),
        ):
            same = {key: first[key] for key in keys if key in first}
            alike = Mistake(0, words, convention, shown=functools.partial(_with, same))
            with self._around(together=True) as around:
                one, other = around.answers(alike, numbers), apart.answers(alike, numbers)
            if one is not None and other is not None and self._are_same(one, other):
                return functools.partial(Tried, words, convention)
        return None

    @contextmanager
    def _around(self, *, together: bool) -> Iterator[Around]:
        once = self._repeats and not together
        with self._probe.own_server(self._config, [] if once else ["--renew"]) as server:
            connect = functools.partial(self._probe.connected, server.url)
            with Around(
                self._course, dict(enumerate(self._judgement.given)), connect, once=once, together=together
            ) as around:
                yield around

    def _cameras_without_effect(self, around: Around, cameras: Sequence[str]) -> Iterator[Pattern]:
        """Tell which cameras may be exchanged for darkness."""
        judgement, number = self._judgement, self._replayable[-1]
        for camera in cameras:
            answers = around.answers(Mistake(0, camera, "camera", shown=dark(camera)), [number])
            if answers is None:
                continue
            far = differences([judgement.given[one] for one in answers], list(answers.values()), judgement.spread)
            if max(far.values()) == 0.0:
                yield Pattern(f"a dark {camera} changes no answer: the model does not see it", "camera")

    @property
    def _replayable(self) -> list[int]:
        """The questions whose answers are the same when they are played again; a model may draw otherwise later."""
        questions = self._judgement.session.questions
        return [question.number for question in questions if self._repeats or question.episode == 0]

    def _is_as_before(self, answers: Answers | None, numbers: Sequence[int]) -> bool:
        """Tell whether answers to questions are those of the whole session."""
        return answers is not None and self._are_same({one: self._judgement.given[one] for one in numbers}, answers)

    def _are_same(self, one: Answers, other: Answers) -> bool:
        found = differences([one[number] for number in other], list(other.values()), self._judgement.spread)
        return all(share <= self._judgement.allowed[part] for part, share in found.items())


def _with(same: Observation, seen: Sequence[Observation]) -> list[ObservationDict]:
    return [{**obs, **same} for obs in seen]
