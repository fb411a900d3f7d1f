"""Which other convention fits the demonstrations better than the declared one.

Every single change that parity knows is tried: other words of the model_io block, in a process that loads the model
once; changes around the served adapter, where it converts in code; and for all adapters other histories, instructions
and rates. All are tried on a few questions, those that promise something on all.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl.catalogue import Mistake
from xpl.catalogue.image_changes import black_out
from xpl.client import ClientError
from xpl.conventions.chunk import rates
from xpl.conventions.instruction import blank
from xpl_cli.audit.offline.demonstrations.demonstration_scorer import DemonstrationScorer
from xpl_cli.audit.offline.demonstrations.episodes import BatchedReplay
from xpl_cli.audit.offline.search.loaded_adapter import MistakeAnswers
from xpl_cli.audit.offline.search.mistake_families import MistakeFamilies, ReadInputs
from xpl_cli.audit.offline.search.perturbed_adapter import PerturbedAdapter
from xpl_cli.audit.offline.search.ranking import MistakeFamily, rank
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.packages import conventions

if TYPE_CHECKING:
    from xpl_cli.audit.offline.demonstrations.action_errors import ActionErrors, Chunks, ErrorMetric
    from xpl_cli.audit.offline.demonstrations.certainty import Margin
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.model_io.pairs import Chunk

SEARCH_S: Final = 600.0
"""Longest search, s."""
_LIKE: Final = 0.05
"""Changes whose gains differ by less than this share of the best one's are alike."""
_TOLD: Final = 1.1
"""A convention is told apart if some other one makes the error grow to this share, or shrink as much."""
_FAR: Final = 1.1
"""Nor are those that leave more than this share of the error of holding the pose: of such a policy nothing is told."""
_UNREAD: Final = 6
"""Questions in which an input has to change nothing to be called unread."""
_ALL_ADAPTERS: Final = frozenset((*conventions.HISTORY, "chunk", sdk.Obs.INSTRUCTION))
"""Conventions whose changes around the adapter are tried although it converts by its block."""


@dataclass(frozen=True)
class ScoredChange:
    """A change that was tried.

    Attributes:
        words: as a finding says it: `channels: bgr`.
        convention: of the vocabulary of reference.py.
        in_block: whether it is a word of the model_io block.
        margin: how it fits, beside what is declared.
        given: by question what would be commanded; empty where it was tried on a few questions only.
    """

    words: str
    convention: str
    in_block: bool
    margin: Margin
    answers: Chunks


@dataclass(frozen=True)
class ConventionSearchResult:
    """What a search came to.

    Attributes:
        tried: how many changes were tried.
        complete: whether there was time for all.
        best: of those that fit better, the one that fits best; None if none does.
        ties: others that fit as well.
        told: conventions on which other words fit otherwise, sorted.
        untold: those on which none did: the demonstrations say nothing of them.
        unread: cameras and texts that change no answer, and `history` if the observations before the last do not.
        far: changes that fit better, and yet no better than holding the pose; none where there is a best one.
        deaf: name and convention of what is unread, although the model_io block hands it over, and episodes differ in
            it.
        first: words, convention and share of the error of all that were tried on a few questions.
        held: those that were tried on all.
    """

    tried: int
    complete: bool
    best: ScoredChange | None
    ties: tuple[ScoredChange, ...]
    determined: tuple[str, ...]
    undetermined: tuple[str, ...]
    unread: tuple[str, ...]
    far: tuple[str, ...]
    unconnected: tuple[tuple[str, str], ...] = ()
    first_round: tuple[tuple[str, str, float], ...] = ()
    final_round: tuple[ScoredChange, ...] = ()


class ConventionSearch:
    """The search for one adapter.

    Args:
        probe: the adapter, served for the robot and action type of the demonstrations.
        ruler: measures against what was done.
        given: the adapter's own answers to all questions, empty where it refused one.
        refused: the numbers of those.
        seconds: how long it may take.
    """

    def __init__(
        self,
        probe: Probe,
        ruler: ErrorMetric,
        given: Sequence[Chunk],
        refused: Collection[int],
        seconds: float = SEARCH_S,
    ) -> None:
        self._probe, self._ruler, self._given, self._refused = probe, ruler, given, frozenset(refused)
        self._session = ruler.session
        self._course = BatchedReplay(self._session)
        until = time.monotonic() + min(seconds, probe.options.time_limit.remaining)
        self._ways = MistakeFamilies(probe, self._course, {}, until, self._read)
        self._demonstrated = DemonstrationScorer(ruler, given, self._refused)
        self._complete = True

    def run(self) -> ConventionSearchResult:
        """Try all mistakes."""
        with self._ways.loaded, self._perturb_server() as around:
            by_block = self._search_block()
            found = [*(by_block or ()), *self._search_outer_changes(around, all_of_them=by_block is None)]
        with self._perturb_server(once=False) as around:
            unread = tuple(self._find_unread(around))
        better = [one for one in found if one.given and one.margin.is_better]
        alike = _best_and_ties([one for one in better if self._is_near(one)])
        first = self._demonstrated.first_round
        told = {convention for _, convention, share in first if not 1 / _TOLD < share < _TOLD}
        return ConventionSearchResult(
            tried=self._demonstrated.count,
            complete=self._complete,
            best=alike[0] if alike else None,
            ties=tuple(alike[1:]),
            determined=tuple(sorted(told)),
            undetermined=tuple(sorted({convention for _, convention, _ in first} - told)),
            unread=unread,
            unconnected=tuple(self._find_unconnected(unread)),
            far=tuple(one.words for one in better) if not alike else (),
            first_round=tuple(first),
            final_round=tuple(found),
        )

    # -- families ------------------------------------------------------------------------------------------------------

    def _search_block(self) -> list[ScoredChange] | None:
        """Return what other words of the block come to; None where the adapter does not convert by it alone."""
        family = self._ways.block_family(_is_decidable)
        if family is None:
            return None
        ways, block = self._ways, self._ways.case.block

        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[MistakeAnswers]:
            if not self._refused:
                # What is drawn depends on how it is asked, so that changes are held against answers asked alike.
                own = ways.loaded.answers_by_block([block], wanted, ways.seconds_left)
                self._demonstrated.set_baseline(own[0] if own else None, wanted)
            yield from family.answers(chosen, wanted)

        changes = self._rank_changes(replace(family, answers=ask), in_block=True)
        if not ways.by_block:  # what the block alone does not say is no question of time
            self._complete = True
            return None
        return changes

    def _search_outer_changes(self, around: PerturbedAdapter, *, all_of_them: bool) -> list[ScoredChange]:
        """Return what changes around the adapter come to."""
        found, chunks = [], set[str]()
        for one in (*rates(), *self._ways.outer_mistakes):
            # Of those of equal words the first orders the steps. The others order their changes, from the state: that
            # takes away how far a prediction begins from there, which brings any policy nearer.
            again, is_chunk = one.description in chunks, one.convention == "chunk"
            chunks |= {one.description} if is_chunk else set()
            wanted = _is_decidable(one) and not (is_chunk and again)
            if wanted and (all_of_them or one.convention in _ALL_ADAPTERS):
                found.append(one)

        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[MistakeAnswers]:
            for number in chosen:
                if self._ways.seconds_left <= 0:
                    return
                one = found[number]
                yield MistakeAnswers(one.description, one.convention, self._answers(around, one, wanted))

        self._demonstrated.set_baseline(None, ())
        return self._rank_changes(MistakeFamily(found, ask), in_block=False)

    def _find_unread(self, around: PerturbedAdapter) -> Iterator[str]:
        """Yield the cameras and texts of which an answer does not depend."""
        shown = [
            (camera, Mistake(0, camera, "camera", change_observations=black_out(camera)))
            for camera in self._ways.case.cameras
        ]
        if self._ways.case.instructions:
            shown.append((sdk.Obs.INSTRUCTION, Mistake(0, "", sdk.Obs.INSTRUCTION, change_observations=blank)))
        if self._history > 1:
            shown.append(
                (
                    "history",
                    Mistake(0, "", "history_length", change_observations=lambda seen: [dict(seen[-1])], windowed=True),
                )
            )
        later = [
            number
            for number in self._demonstrated.rounds[0]
            if number not in self._refused and self._session.question_steps[number][1] > 0
        ]
        if not (numbers := later[:_UNREAD]):
            return
        # In a connection of its own each time, so that equal numbers are drawn.
        same = self._answers(
            around,
            Mistake(0, "", "", change_observations=lambda seen: [dict(obs) for obs in seen], windowed=True),
            numbers,
        )
        if same is None:
            return
        own = self._ruler.errors(same, numbers)
        for name, mistake in shown:
            given = self._answers(around, mistake, numbers)
            if given is not None and _are_equal(own, self._ruler.errors(given, numbers)):
                yield name

    def _find_unconnected(self, unread: Sequence[str]) -> Iterator[tuple[str, str]]:
        """Yield what is unread although the model_io block hands it over, with its convention."""
        handed = {camera for entry in self._ways.model_io.images for camera in entry["cameras"]}
        said = {one.trajectory.instructions[:1] for one in self._session.recordings}
        for name in unread:
            if name in handed:
                yield name, "camera"
            elif name == "history":
                yield name, "history_length"
            elif name in self._ways.model_io.data and len(said) > 1:
                yield name, name

    def _rank_changes(self, family: MistakeFamily, *, in_block: bool) -> list[ScoredChange]:
        """Return the mistakes whose undoing fits better on a few questions, tried on all."""
        tried = rank(family, self._demonstrated)
        self._complete = self._complete and len(tried.first_round) == len(family.mistakes)
        changes = []
        for _, one in tried.final_round:
            found = self._demonstrated.margin(one, self._demonstrated.everything)
            if found is not None and one.answers is not None and not self._demonstrated.hardly_moves(one.answers):
                changes.append(ScoredChange(one.words, one.convention, in_block, found, one.answers))
        return changes

    def _is_near(self, change: ScoredChange) -> bool:
        """Tell whether a change brings the policy about as near as holding the pose, or nearer."""
        found = self._ruler.errors(change.answers, self._demonstrated.everything)
        still = self._ruler.errors(self._ruler.hold_pose(), self._demonstrated.everything)
        known = found.known & still.known
        return bool(found.steps[known].mean() <= _FAR * still.steps[known].mean())

    def _answers(self, around: PerturbedAdapter, mistake: Mistake, wanted: Sequence[int]) -> Chunks | None:
        try:
            return around.answers(mistake, [number for number in wanted if number not in self._refused])
        except (NotRun, ClientError, ValueError):
            return None

    def _perturb_server(self, *, once: bool = True) -> PerturbedAdapter:
        connect = partial(self._probe.connected, self._probe.server().url)
        return PerturbedAdapter(self._course, dict(enumerate(self._given)), connect, once=once)

    @property
    def _history(self) -> int:
        """Observations that the model_io block hands over; 1 where it does not say."""
        history = self._ways.model_io.longest
        return 1 if history is None else history.length

    @cached_property
    def _read(self) -> ReadInputs:
        """What the adapter reads of the demonstrations, everything if it does not say that."""
        read = list(self._probe.package.manifest.read)
        there = self._session.recordings[0].trajectory.cameras
        reads = [name.partition(".")[2] for name in read if name.startswith(f"{sdk.Obs.STATE}.")]
        texts = {text for one in self._session.recordings for text in one.trajectory.instructions}
        cameras = [name for name in there if not read or f"{sdk.Obs.VISION}.{name}" in read]
        return ReadInputs(cameras, reads or None, sorted(texts) if not read or sdk.Obs.INSTRUCTION in read else [])


def _is_decidable(mistake: Mistake) -> bool:
    """Tell whether demonstrations may decide about a mistake.

    Filters change less than any policy's own error. Demonstrated grippers are closed or open, and a threshold brings
    every prediction nearer to that, however it is converted.
    """
    return mistake.convention != "image_filter" and "threshold" not in mistake.description


def _best_and_ties(changes: Sequence[ScoredChange]) -> list[ScoredChange]:
    """Return the change that fits best, and those that fit as well, the likeliest first; equal words count once."""
    if not changes:
        return []
    least = min(one.margin.share for one in changes)
    found: dict[str, ScoredChange] = {}
    for one in changes:
        if one.margin.share - least <= _LIKE * (1 - least):
            found.setdefault(one.words, one)
    return list(found.values())


def _are_equal(one: ActionErrors, other: ActionErrors) -> bool:
    return bool(((one.values == other.values) | ~one.known[..., None]).all())
