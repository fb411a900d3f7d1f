"""Which mistake explains that an adapter's answers differ from the golden ones; where none does, which two.

The mistakes of the catalogue are tried in one way after another until one explains it: as other words of the model_io
block, where the adapter converts by its block alone; for conversions in code, as changes of what it commands, which
cost no play, of what its `encode` makes, and of what it is shown. Then those that ease the difference are undone, and
the others tried besides. The time is bounded: a finding without a cause is still a finding.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl.client import ClientError
from xpl.conventions.point import tool
from xpl.convert import ConversionError
from xpl_cli.audit.offline.parity.golden_scorer import GoldenPairScorer
from xpl_cli.audit.offline.parity.observation_search import ObservationSearch
from xpl_cli.audit.offline.search.mistake_families import ExplainsAll, MistakeFamilies, ReadInputs
from xpl_cli.audit.offline.search.ranking import MistakeFamily, rank
from xpl_cli.audit.offline.search.replay import overrides
from xpl_cli.audit.offline.search.session_replay import SessionReplay
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.audit.served.rounding import OF_SPAN
from xpl_cli.basics.errors import UserError
from xpl_cli.model_io import reference_file
from xpl_cli.model_io.difference import EpisodeAnswers
from xpl_cli.model_io.explain import Explanation, TriedChange
from xpl_cli.model_io.linear_fit import fit_linear
from xpl_cli.model_io.number_order import order_patterns
from xpl_cli.model_io.patterns import Pattern, PolicyKind, patterns
from xpl_cli.model_io.record import is_free
from xpl_cli.model_io.rigid_fit import fit_rigid

if TYPE_CHECKING:
    import numpy as np

    from xpl_cli.audit.offline.parity.judgement import Judgement
    from xpl_cli.audit.offline.search.loaded_adapter import MistakeAnswers
    from xpl_cli.audit.offline.search.ranking import RankingResult
    from xpl_cli.audit.served.probe import Probe


SEARCH_S: Final = 240.0
"""Longest search, s."""
_LIKELIEST: Final = 2
"""Mistakes of a family that are undone so that all others are tried besides."""
_FIRSTS: Final = 6
"""Mistakes of a family that are undone so that some others are tried besides, ..."""
_EASED: Final = 60
"""... and those that are tried so."""


@dataclass(frozen=True)
class ParitySearchResult:
    """What a search came to.

    Attributes:
        explanation: the best mistake, or two.
        in_block: whether it is a word of the model_io block.
    """

    explanation: Explanation
    in_block: bool


class ParitySearch:
    """The search for one session.

    Args:
        probe: the adapter.
        judgement: of its answers; something differs.
        settings: keys of deploy.yml that the pairs were recorded with.
        seconds: how long it may take.
    """

    def __init__(
        self, probe: Probe, judgement: Judgement, settings: Mapping[str, object], seconds: float = SEARCH_S
    ) -> None:
        self._probe, self._judgement = probe, judgement
        self._course = SessionReplay(judgement.session)
        self._config = overrides(judgement.session, settings)
        until = time.monotonic() + min(seconds, probe.options.time_limit.remaining)
        self._ways = MistakeFamilies(probe, self._course, self._config, until, self._read)
        self._until = until
        self._ruler = GoldenPairScorer(self._course, judgement, self._course.all_questions)
        self._tried: list[tuple[MistakeFamily, RankingResult]] = []
        self._unseen: list[Pattern] = []
        self._known: dict[tuple[int, int], MistakeAnswers | None] = {}

    def run(self) -> ParitySearchResult | None:
        """Return the mistake that explains the difference best, or the two, None if none lowers it.

        A word of the block is preferred to a change around the adapter that does the same.
        """
        with self._ways.loaded:
            return self._run()

    def _run(self) -> ParitySearchResult | None:
        found: list[ParitySearchResult] = []
        for way in (self._by_block, self._by_commands, self._by_inputs, self._by_shown):
            explanation = way()
            if explanation is None:
                continue
            found.append(ParitySearchResult(explanation, in_block=way == self._by_block))
            if explanation.cause is not None:
                return found[-1]
        self._ways.halve_time()
        # What is as small as what kernels round is explained by two of many mistakes, and looks like any pattern.
        is_large = max(self._ruler.before.values()) > OF_SPAN
        two = next(self._two(), None) if is_large else None
        if two is not None:
            return two
        near = [one for one in found if one.explanation.near is not None]
        best = next((one for one in (*near, *found) if one.explanation.text), found[0])
        judgement = self._judgement
        told = (
            *self._unseen,
            *order_patterns(self._threads, judgement.shares, judgement.tolerance),
            *(patterns(self._threads, judgement.spread, judgement.tolerance, self._kind) if is_large else ()),
        )
        explanation = replace(best.explanation, patterns=told)
        return ParitySearchResult(explanation, best.in_block) if explanation.text else None

    # -- one mistake ---------------------------------------------------------------------------------------------------

    def _by_block(self) -> Explanation | None:
        """Return what other words of the block explain; None where the adapter does not convert by it alone."""
        found = self._by_words(self._ruler.leaves_nothing)
        if found is None or found.cause is not None:
            return found
        ((family, tried),) = self._tried
        if len(tried.first_round) == len(family.mistakes) or self._ways.seconds_left <= 0:
            return found
        # What leaves nothing of one question leaves something of others: then all are tried.
        return self._by_words(lambda _answered: False)

    def _by_words(self, enough: ExplainsAll) -> Explanation | None:
        family = self._ways.block_family(enough=enough)
        tried = None if family is None else rank(family, self._ruler)
        if family is None or tried is None or not self._ways.by_block:
            return None
        self._tried = [(family, tried)]
        found = self._ruler.explain_ranking(tried)
        if found.cause is None:
            return found
        # What is less likely was not tried; what of the same convention these pairs do not tell from it is to be said.
        later = range(len(tried.first_round), len(family.mistakes))
        alike = [number for number in later if family.mistakes[number].convention == found.cause.convention]
        others = MistakeFamily(
            [family.mistakes[number] for number in alike],
            lambda chosen, wanted: family.answers([alike[place] for place in chosen], wanted),
        )
        last = [*tried.final_round, *rank(others, self._ruler).final_round]
        return self._ruler.explain_tried([self._ruler.score(answered) for _, answered in last])

    def _by_commands(self) -> Explanation:
        """Return what changes of the answers that are known explain."""
        family = self._ways.action_family(dict(enumerate(self._judgement.answers)), self._ruler.leaves_nothing)
        tried = rank(family, self._ruler)
        self._tried.append((family, tried))
        found = self._ruler.explain_ranking(tried)
        if found.cause is not None:
            return found
        judgement = self._judgement
        line = fit_linear(self._threads, judgement.shares, judgement.spread, judgement.tolerance)
        fits = [] if line is None else [line]
        fits += fit_rigid(self._threads, judgement.shares, judgement.spread, judgement.tolerance, self._tool)
        fit = self._ruler.explain_tried(fits)
        return fit if fit.cause is not None or (fit.partial and not found.partial) else found

    def _by_inputs(self) -> Explanation | None:
        """Return what changes of encoded inputs explain; None if there is no time for them."""
        if self._ways.seconds_left <= 0:
            return None
        family = self._ways.input_family()
        tried = rank(family, self._ruler)
        self._tried.append((family, tried))
        found = self._ruler.explain_tried([self._both_ways(answered) for _, answered in tried.final_round])
        if found.cause is None and self._ways.loaded.draws == 0 and self._kind.draws:
            self._unseen.append(Pattern("the adapter draws no number, and the model samples", "sampling"))
        return found

    def _both_ways(self, answered: MistakeAnswers) -> TriedChange:
        """Return a change of what goes in, with the line that what comes out is then of the golden answers, if any."""
        tried = self._ruler.score(answered)
        line = self._line(answered, tried)
        return tried if line is None else TriedChange(f"{tried.words}, both ways", tried.convention, line.remaining)

    def _by_shown(self) -> Explanation | None:
        """Return what changes of what is shown explain; None if the adapter cannot be served for it."""
        shown = ObservationSearch(self._probe, self._course, self._judgement, self._config, repeats=self._repeats)
        found = [one for one in self._ways.outer_mistakes if one.change_observations is not None]
        try:
            explanation = shown.explain(found, self._ways, self._until)
        except (NotRun, ClientError):
            return None
        finally:
            self._unseen += shown.patterns
        return explanation

    # -- two mistakes --------------------------------------------------------------------------------------------------

    def _two(self) -> Iterator[ParitySearchResult]:
        """Yield what explains the difference by two mistakes of which each eases it.

        Both are undone in one way, all pairs in one contest; or the second is one of commands, or a line, of the
        answers with the first one undone.
        """
        eased = [(family, tried, self._ruler.improving(tried.first_round, _EASED)) for family, tried in self._tried]
        for family, _, good in eased:
            yield from self._found(family, [one for place in good[:_FIRSTS] for one in self._with_line(family, place)])
        for family, tried, good in eased:
            # Those first that ease it most: the time may not reach over all.
            ordered = sorted(itertools.combinations(range(len(good)), 2), key=lambda pair: (sum(pair), pair))
            some = [(good[one], good[other]) for one, other in ordered if one < _FIRSTS]
            every = [
                (one, other) for one in good[:_LIKELIEST] for other in range(len(tried.first_round)) if other != one
            ]
            yield from self._found(family, self._pairs(family, tried, list(dict.fromkeys([*some, *every]))))
        for family, _, good in eased:
            for place in good[:_FIRSTS]:
                if self._ways.seconds_left > 0:
                    yield from self._found(family, self._with_commands(family, place))

    def _pairs(
        self, family: MistakeFamily, tried: RankingResult, pairs: Sequence[tuple[int, int]]
    ) -> list[TriedChange]:
        """Return what is left where both of each pair are undone, of those that are worth all questions."""
        both = family.combine(pairs) if pairs and self._ways.seconds_left > 0 else None
        if both is None:
            return []
        named = [(tried.first_round[one], tried.first_round[other]) for one, other in both.pairs]
        return [self._ruler.score_pair(*named[at], one.answers) for at, one in rank(both, self._ruler).final_round]

    def _found(self, family: MistakeFamily, tried: Sequence[TriedChange]) -> Iterator[ParitySearchResult]:
        explanation = self._ruler.explain_tried(tried)
        if explanation.cause is not None:
            yield ParitySearchResult(explanation, in_block=self._ways.by_block and family is self._tried[0][0])

    def _with_line(self, family: MistakeFamily, place: int) -> list[TriedChange]:
        """Return what is left where one mistake is undone, and commands are a line of the golden ones, if they are."""
        first = self._undone(family, place)
        line = None if first is None else self._line(first, self._ruler.score(first))
        if first is None or line is None:
            return []
        return [TriedChange(first.words, first.convention, line.remaining, (line.words, line.convention))]

    def _with_commands(self, family: MistakeFamily, place: int) -> list[TriedChange]:
        """Return what is left where one mistake is undone, and one of commands besides."""
        first = self._undone(family, place)
        if first is None or first.answers is None:
            return []
        commands = rank(self._ways.action_family(first.answers, self._ruler.leaves_nothing), self._ruler).final_round
        return [self._ruler.score_pair(first, one, one.answers) for _, one in commands]

    def _undone(self, family: MistakeFamily, place: int) -> MistakeAnswers | None:
        """Return the answers to all questions where one mistake is undone, None where they are not all known."""
        key = (id(family), place)
        if key not in self._known:
            first = next(family.answers([place], self._ruler.everything), None) if self._ways.seconds_left > 0 else None
            is_known = first is not None and first.answers is not None and _is_known(first.answers)
            self._known[key] = first if is_known else None
        return self._known[key]

    # -- what is known -------------------------------------------------------------------------------------------------

    def _line(self, answered: MistakeAnswers, tried: TriedChange) -> TriedChange | None:
        """Return the line that answers under a mistake are of the golden ones, if any is."""
        judgement = self._judgement
        if answered.answers is None or max(tried.remaining.values()) <= judgement.tolerance:
            return None
        if not _is_known(answered.answers) or len(answered.answers) != len(self._course.all_questions):
            return None
        threads = self._threads_of([answered.answers[number] for number in self._course.all_questions])
        return fit_linear(threads, tried.remaining, judgement.spread, judgement.tolerance)

    @property
    def _tool(self) -> np.ndarray | None:
        """The point between the fingertips in the flange, None where the standard does not know it."""
        try:
            return tool(self._judgement.session.robot)
        except ConversionError:
            return None

    @property
    def _kind(self) -> PolicyKind:
        return PolicyKind(
            keeps_state=bool(self._ways.model_io.recurrent) or self._ways.manifest.temporal.kind == "memory",
            history=self._ways.manifest.reach,
            draws=self._draws or "sampling" in self._named,
        )

    @cached_property
    def _named(self) -> Collection[str]:
        """The conventions that reference.py names."""
        try:
            return reference_file.read_file(self._probe.package.path).conventions
        except UserError:
            return ()

    @cached_property
    def _threads(self) -> list[EpisodeAnswers]:
        return self._threads_of(self._judgement.answers)

    def _threads_of(self, given: Sequence[Any]) -> list[EpisodeAnswers]:
        """Return the episodes of each environment, with some answers."""
        questions, judgement = self._judgement.session.questions, self._judgement
        return [
            EpisodeAnswers(
                self._course.observations_of(questions[episode[-1]]),
                [questions[number].asked_at[-1] for number in episode],
                [judgement.golden[number] for number in episode],
                [given[number] for number in episode],
            )
            for episode in self._course.group_by_episode(self._course.all_questions)
        ]

    @cached_property
    def _read(self) -> ReadInputs:
        """What the adapter reads, everything if it does not say that."""
        read, session = list(self._probe.package.manifest.read), self._judgement.session
        shown = [self._course.observation(*question.recipes[-1]) for question in session.questions]
        texts = sorted({obs[sdk.Obs.INSTRUCTION] for obs in shown})
        if not read:
            return ReadInputs(list(session.cameras), None, texts)
        cameras, fields = (
            [name.partition(".")[2] for name in read if name.startswith(f"{group}.")]
            for group in (sdk.Obs.VISION, sdk.Obs.STATE)
        )
        return ReadInputs(cameras, fields, texts if sdk.Obs.INSTRUCTION in read else [])

    @property
    def _repeats(self) -> bool:
        """Whether a reset is enough between two plays: the model draws nothing, or nothing that could be had again."""
        return is_free(self._ways.manifest) or not self._draws

    @property
    def _draws(self) -> bool:
        """Whether the adapter says that its model draws."""
        return not self._ways.manifest.deterministic or self._ways.model_io.draws


def _is_known(given: Mapping[int, Sequence[Any]]) -> bool:
    """Tell whether every step of all answers is known."""
    return all(step is not None for chunk in given.values() for step in chunk)
