"""Which other convention fits the demonstrations better than the declared one.

Every single change that parity knows is tried: other words of the model_io block, in a process that loads the model
once; changes around the served adapter, where it converts in code; and for all adapters other histories, instructions
and rates. All are tried on a few questions, those that promise something on all.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl import checkpoint
from xpl.client import ClientError
from xpl.convert import ConversionError
from xpl.manifest import ModelIO
from xpl_cli.audit.offline.demonstrations.certainty import Margin, margin
from xpl_cli.audit.offline.demonstrations.episodes import Asking, few
from xpl_cli.audit.offline.demonstrations.rates import rates
from xpl_cli.audit.offline.parity.around import Around
from xpl_cli.audit.offline.parity.changed import Changed
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.model_io.alternatives.block import alternatives
from xpl_cli.model_io.alternatives.prompts import templates
from xpl_cli.model_io.alternatives.signals import Signal, signals
from xpl_cli.model_io.alternatives.signals.pictures import dark
from xpl_cli.model_io.alternatives.signals.texts import texts
from xpl_cli.packages import conventions

if TYPE_CHECKING:
    from xpl.manifest import Manifest
    from xpl_cli.audit.offline.demonstrations.measure import Chunks, Errors, Ruler
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.model_io.pairs import Chunk

SEARCH_S: Final = 600.0
"""Longest search, s."""
_PROMISING: Final = 0.93
"""What a change may leave of the error on a few questions to be tried on all."""
_MOST: Final = 32
"""Changes that are tried on all questions."""
_LIKE: Final = 0.05
"""Changes whose gains differ by less than this share of the best one's are alike."""
_TOLD: Final = 1.1
"""A convention is told apart if some other one makes the error grow to this share, or shrink as much."""
_HARDLY: Final = 0.25
"""Changes under which arms are led less far than by this share of what was done are not named: who hardly moves is
nearer than who moves wrongly, whatever is wrong."""
_FAR: Final = 1.1
"""Nor are those that leave more than this share of the error of holding the pose: of such a policy nothing is told."""
_UNREAD: Final = 6
"""Questions in which an input has to change nothing to be called unread."""
_ALL_ADAPTERS: Final = frozenset((*conventions.HISTORY, "chunk", sdk.Obs.INSTRUCTION))
"""Conventions whose changes around the adapter are tried although it converts by its block."""

Ask = Callable[[Sequence[int], Sequence[int]], Iterator["Chunks | None"]]
"""Answers to questions, the second, under changes by their numbers, the first, as far as the time reaches."""


@dataclass(frozen=True)
class Change:
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
    given: Chunks


@dataclass(frozen=True)
class Outcome:
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
    best: Change | None
    ties: tuple[Change, ...]
    told: tuple[str, ...]
    untold: tuple[str, ...]
    unread: tuple[str, ...]
    far: tuple[str, ...]
    deaf: tuple[tuple[str, str], ...] = ()
    first: tuple[tuple[str, str, float], ...] = ()
    held: tuple[Change, ...] = ()


class Search:
    """The search for one adapter.

    Args:
        probe: the adapter, served for the robot and action type of the demonstrations.
        ruler: measures against what was done.
        given: the adapter's own answers to all questions, empty where it refused one.
        refused: the numbers of those.
        seconds: how long it may take.
    """

    def __init__(
        self, probe: Probe, ruler: Ruler, given: Sequence[Chunk], refused: Collection[int], seconds: float = SEARCH_S
    ) -> None:
        self._probe, self._ruler, self._given, self._refused = probe, ruler, given, frozenset(refused)
        self._manifest: Manifest = probe.package.manifest
        self._model_io = self._manifest.model_io or ModelIO()
        self._session = ruler.session
        self._course = Asking(self._session)
        self._everything = list(range(len(given)))
        self._few = few(self._session.asked)
        self._until = time.monotonic() + min(seconds, probe.options.clock.left)
        self._first: list[tuple[str, str, float]] = []
        self._own: dict[tuple[int, ...], Errors] = {}
        self._count = 0
        self._complete = True

    def run(self) -> Outcome:
        """Try all changes."""
        by_block = self._by_block()
        with self._around() as around:
            found = [*(by_block or ()), *self._by_signals(around, all_of_them=by_block is None)]
        with self._around(once=False) as around:
            unread = tuple(self._unread(around))
        better = [one for one in found if one.given and one.margin.is_better]
        alike = _alike([one for one in better if self._is_near(one)])
        told = {convention for _, convention, share in self._first if not 1 / _TOLD < share < _TOLD}
        untold = sorted({convention for _, convention, _ in self._first} - told)
        return Outcome(
            tried=self._count,
            complete=self._complete,
            best=alike[0] if alike else None,
            ties=tuple(alike[1:]),
            told=tuple(sorted(told)),
            untold=tuple(untold),
            unread=unread,
            deaf=tuple(self._deaf(unread)),
            far=tuple(one.words for one in better) if not alike else (),
            first=tuple(self._first),
            held=tuple(found),
        )

    # -- families ------------------------------------------------------------------------------------------------------

    def _by_block(self) -> list[Change] | None:
        """Return what other words of the block come to; None where the adapter does not convert by it alone."""
        if not self._model_io:
            return None
        package, chunk = self._probe.package, self._manifest.temporal.chunk
        settled = package.config(dict(self._probe.options.overrides))
        folders = checkpoint.folders(settled, package.path)
        robot, action_type = self._session.robot, self._session.action_type
        try:
            known = alternatives(self._model_io.data, robot, action_type, folders, chunk, templates(package.path))
            changes = [one for one in known if _can_be_told(one.words, one.convention)]
        except ConversionError:
            return None
        converts = True
        again = Changed(self._probe, self._course, settled)

        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[Chunks | None]:
            nonlocal converts
            tried = [self._model_io.data, *(changes[number].block for number in chosen)]
            found = again.blocks(tried, wanted, self._left)
            converts = converts and found is not None
            if found and found[0] is not None and not self._refused:
                # What is drawn depends on how it is asked, so that changes are held against answers asked alike.
                self._own[tuple(wanted)] = self._ruler.errors(found[0], wanted)
            yield from (found or [])[1:]

        kept = self._held([(one.words, one.convention) for one in changes], ask, in_block=True)
        if not converts:  # what the block alone does not say is no question of time
            self._complete = True
            return None
        return kept

    def _by_signals(self, around: Around, *, all_of_them: bool) -> list[Change]:
        """Return what changes around the adapter come to."""
        history = self._model_io.longest
        around_it = signals(
            self._session.robot,
            self._session.action_type,
            cameras=self._cameras,
            reads=[name.partition(".")[2] for name in self._inputs if name.startswith(f"{sdk.Obs.STATE}.")] or None,
            history=self._manifest.reach if history is None else history.length,
            stride=1 if history is None else history.stride,
            instructions=self._instructions,
        )
        found, chunks = [], set[str]()
        for one in (*rates(), *around_it):
            # Of those of equal words the first orders the steps. The others order their changes, from the state: that
            # takes away how far a prediction begins from there, which brings any policy nearer.
            again, is_chunk = one.words in chunks, one.convention == "chunk"
            chunks |= {one.words} if is_chunk else set()
            wanted = _can_be_told(one.words, one.convention) and not (is_chunk and again)
            if wanted and (all_of_them or one.convention in _ALL_ADAPTERS):
                found.append(one)

        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[Chunks | None]:
            for number in chosen:
                if self._left <= 0:
                    return
                yield self._answers(around, found[number], wanted)

        return self._held([(one.words, one.convention) for one in found], ask, in_block=False)

    def _unread(self, around: Around) -> Iterator[str]:
        """Yield the cameras and texts of which an answer does not depend."""
        blank = next((one for one in texts() if one.words.endswith(": none")), None)
        shown = [(camera, Signal(0, camera, "camera", dark(camera))) for camera in self._cameras]
        if self._instructions and blank is not None:
            shown.append((sdk.Obs.INSTRUCTION, blank))
        if self._history > 1:
            shown.append(
                ("history", Signal(0, "history", "history_length", lambda seen: [dict(seen[-1])], windowed=True))
            )
        later = [number for number in self._few if number not in self._refused and self._session.asked[number][1] > 0]
        if not (numbers := later[:_UNREAD]):
            return
        # In a connection of its own each time, so that equal numbers are drawn.
        same = self._answers(
            around, Signal(0, "", "", lambda seen: [dict(obs) for obs in seen], windowed=True), numbers
        )
        if same is None:
            return
        own = self._ruler.errors(same, numbers)
        for name, signal in shown:
            given = self._answers(around, signal, numbers)
            if given is not None and _same(own, self._ruler.errors(given, numbers)):
                yield name

    def _deaf(self, unread: Sequence[str]) -> Iterator[tuple[str, str]]:
        """Yield what is unread although the model_io block hands it over, with its convention."""
        handed = {camera for entry in self._model_io.images for camera in entry["cameras"]}
        said = {one.trajectory.instructions[:1] for one in self._session.recordings}
        for name in unread:
            if name in handed:
                yield name, "camera"
            elif name == "history":
                yield name, "history_length"
            elif name in self._model_io.data and len(said) > 1:
                yield name, name

    # -- trying --------------------------------------------------------------------------------------------------------

    def _held(self, named: Sequence[tuple[str, str]], ask: Ask, *, in_block: bool) -> list[Change]:
        """Return the changes that fit better on a few questions, tried on all."""
        first: list[tuple[float, int]] = []
        asked = 0
        for number, given in enumerate(ask(range(len(named)), self._few)):
            asked += 1
            found = self._margin(given, self._few, in_block=in_block)
            if found is not None:
                self._first.append((*named[number], found.share))
                first.append((found.share, number))
        self._count += asked
        self._complete = self._complete and asked == len(named)
        good = sorted(number for share, number in sorted(first)[:_MOST] if share <= _PROMISING)
        changes = []
        for number, given in zip(good, ask(good, self._everything) if good else (), strict=False):
            found = self._margin(given, self._everything, in_block=in_block)
            if found is not None and given is not None and not self._ruler.moved(given, self._everything) < _HARDLY:
                changes.append(Change(*named[number], in_block, found, given))
        return changes

    def _margin(self, given: Chunks | None, wanted: Sequence[int], *, in_block: bool) -> Margin | None:
        if given is None:
            return None
        own = self._own.get(tuple(wanted)) if in_block else None
        declared = self._declared(tuple(wanted)) if own is None else own
        changed = self._ruler.errors(given, wanted)
        return margin(declared, changed, [self._session.asked[number][0] for number in wanted])

    @cache  # noqa: B019 - lives as long as one search
    def _declared(self, wanted: tuple[int, ...]) -> Errors:
        return self._ruler.errors({number: self._given[number] for number in wanted}, wanted, self._refused)

    def _is_near(self, change: Change) -> bool:
        """Tell whether a change brings the policy about as near as holding the pose, or nearer."""
        found = self._ruler.errors(change.given, self._everything)
        still = self._ruler.errors(self._ruler.still(), self._everything)
        known = found.known & still.known
        return bool(found.steps[known].mean() <= _FAR * still.steps[known].mean())

    def _answers(self, around: Around, signal: Signal, wanted: Sequence[int]) -> Chunks | None:
        try:
            return around.answers(signal, [number for number in wanted if number not in self._refused])
        except (NotRun, ClientError, ValueError):
            return None

    def _around(self, *, once: bool = True) -> Around:
        connect = partial(self._probe.connected, self._probe.server().url)
        return Around(self._course, self._given, connect, once=once)

    @property
    def _history(self) -> int:
        """Observations that the model_io block hands over; 1 where it does not say."""
        return 1 if self._model_io.longest is None else self._model_io.longest.length

    @cached_property
    def _inputs(self) -> list[str]:
        return list(self._manifest.read)

    @cached_property
    def _cameras(self) -> list[str]:
        """The cameras that the adapter reads and the demonstrations have."""
        there = self._session.recordings[0].trajectory.cameras
        read = {name.partition(".")[2] for name in self._inputs if name.startswith(f"{sdk.Obs.VISION}.")}
        return [name for name in there if not self._inputs or name in read]

    @cached_property
    def _instructions(self) -> list[str]:
        if self._inputs and sdk.Obs.INSTRUCTION not in self._inputs:
            return []
        return sorted({text for one in self._session.recordings for text in one.trajectory.instructions})

    @property
    def _left(self) -> float:
        return max(0.0, self._until - time.monotonic())


def _can_be_told(words: str, convention: str) -> bool:
    """Tell whether demonstrations may decide about a change.

    Filters change less than any policy's own error. Demonstrated grippers are closed or open, and a threshold brings
    every prediction nearer to that, however it is converted.
    """
    return convention != "image_filter" and "threshold" not in words


def _alike(changes: Sequence[Change]) -> list[Change]:
    """Return the change that fits best, and those that fit as well, the likeliest first; equal words count once."""
    if not changes:
        return []
    least = min(one.margin.share for one in changes)
    found: dict[str, Change] = {}
    for one in changes:
        if one.margin.share - least <= _LIKE * (1 - least):
            found.setdefault(one.words, one)
    return list(found.values())


def _same(one: Errors, other: Errors) -> bool:
    return bool(((one.values == other.values) | ~one.known[..., None]).all())
