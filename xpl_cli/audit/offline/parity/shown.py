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
from xpl_cli.audit.offline.parity.around import Around
from xpl_cli.audit.offline.parity.contest import Ask, Contest
from xpl_cli.model_io.alternatives.signals import Signal
from xpl_cli.model_io.alternatives.signals.pictures import dark
from xpl_cli.model_io.difference import differences
from xpl_cli.model_io.explain import Explanation, Tried
from xpl_cli.model_io.patterns import Pattern

if TYPE_CHECKING:
    from xpl.contract import Observation, ObservationDict
    from xpl_cli.audit.offline.parity.course import Course
    from xpl_cli.audit.offline.parity.judgement import Judgement
    from xpl_cli.audit.served.probe import Probe

Asking = Callable[[Around, Sequence[Signal], Contest], Ask]
Answers = Mapping[int, Sequence[Any]]

_SAME: Final = Signal(
    0, "each environment asked by itself", "recurrent", shown=lambda seen: [dict(obs) for obs in seen]
)
"""Changes nothing of what is shown."""


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

    def explained(
        self, changes: Sequence[Signal], asking: Asking, cameras: Sequence[str], until: float
    ) -> Explanation | None:
        """Return what changes explain; None if nothing can be said so.

        Args:
            changes: of what is shown.
            asking: returns what tries them.
            cameras: that the adapter reads.
            until: when to end, by the monotonic clock.
        """
        numbers = self._replayable
        contest = Contest(self._course, self._judgement, numbers)
        alone: Explanation | None = None
        if contest.differs:
            with self._around(together=False) as around:
                apart = around.answers(_SAME, numbers)
                if self._is_as_before(apart, numbers):
                    fit = [one for one in changes if not one.windowed or self._repeats]
                    found = contest.held(len(fit), asking(around, fit, contest))
                    if found.cause is None and time.monotonic() < until:
                        self.patterns += self._cameras_without_effect(around, cameras)
                    return found
                alone = contest.explained([Tried(_SAME.words, _SAME.convention, contest.remaining(apart))])
                if alone.cause is not None:
                    crossed = self._crossed(around, numbers)
                    return contest.explained([crossed(contest.remaining(apart))]) if crossed else alone
        return self._all_together([one for one in changes if not one.windowed], asking) or alone

    def _all_together(self, changes: Sequence[Signal], asking: Asking) -> Explanation | None:
        everything = self._course.everything
        contest = Contest(self._course, self._judgement, everything)
        with self._around(together=True) as around:
            if not self._is_as_before(around.answers(_SAME, everything), everything):
                self.patterns.append(
                    Pattern("the same questions, asked once more, have other answers: look at the seed", "sampling")
                )
                return None
            return contest.held(len(changes), asking(around, changes, contest))

    def _crossed(self, apart: Around, numbers: Sequence[int]) -> Callable[[Mapping[str, float]], Tried] | None:
        """Return what to say if environments see only one input of each other: alike in all, it makes no difference."""
        first = self._course.observation(*self._judgement.session.questions[0].shown[0])
        for words, convention, keys in (
            ("each environment's own instruction", sdk.Obs.INSTRUCTION, (sdk.Obs.INSTRUCTION, sdk.Obs.INSTRUCTIONS)),
            ("each environment's own pictures", "camera", (sdk.Obs.VISION,)),
        ):
            same = {key: first[key] for key in keys if key in first}
            alike = Signal(0, words, convention, shown=functools.partial(_with, same))
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
            with Around(self._course, self._judgement.given, connect, once=once, together=together) as around:
                yield around

    def _cameras_without_effect(self, around: Around, cameras: Sequence[str]) -> Iterator[Pattern]:
        """Tell which cameras may be exchanged for darkness."""
        judgement, number = self._judgement, self._replayable[-1]
        for camera in cameras:
            answers = around.answers(Signal(0, camera, "camera", dark(camera)), [number])
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
