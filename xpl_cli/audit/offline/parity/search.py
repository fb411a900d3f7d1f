"""Which single change explains that an adapter's answers differ from the golden ones.

Families of changes (`xpl_cli.model_io.alternatives`) are tried one after another until one explains it: other words of
the model_io block, where the adapter converts by its block alone; for conversions in code, changes of what it commands,
which cost no play, of what its `encode` makes, and of what it is shown. The time is bounded: a finding without a cause
is still a finding.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl import checkpoint
from xpl.client import ClientError
from xpl.convert import ConversionError
from xpl.convert.frames import tool
from xpl.manifest import ModelIO
from xpl_cli.audit.offline.parity.around import Around
from xpl_cli.audit.offline.parity.changed import Changed
from xpl_cli.audit.offline.parity.contest import Ask, Contest
from xpl_cli.audit.offline.parity.course import Course
from xpl_cli.audit.offline.parity.played import overrides
from xpl_cli.audit.offline.parity.shown import Shown
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.basics.errors import UserError
from xpl_cli.model_io import reading
from xpl_cli.model_io.alternatives.block import alternatives
from xpl_cli.model_io.alternatives.encodings import encodings
from xpl_cli.model_io.alternatives.prompts import templates
from xpl_cli.model_io.alternatives.signals import Signal, signals
from xpl_cli.model_io.difference import Thread
from xpl_cli.model_io.explain import Explanation, Tried
from xpl_cli.model_io.fitted import fitted
from xpl_cli.model_io.patterns import Kind, Pattern, patterns
from xpl_cli.model_io.places import places
from xpl_cli.model_io.record import is_free
from xpl_cli.model_io.rigid import rigid

if TYPE_CHECKING:
    import numpy as np

    from xpl.contract import Config
    from xpl_cli.audit.offline.parity.judgement import Judgement
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.model_io.pairs import Chunk


SEARCH_S: Final = 240.0
"""Longest search, s."""
_MANY: Final = 0.45
_FEW: Final = 0.9
"""Shares of the time that is left for changes of encoded inputs: of all, and of those that lower the difference."""


@dataclass(frozen=True)
class Found:
    """What a search came to.

    Attributes:
        explanation: the best single change.
        in_block: whether it is a word of the model_io block.
    """

    explanation: Explanation
    in_block: bool


@dataclass(frozen=True)
class _Inputs:
    """What an adapter reads.

    Attributes:
        cameras: names of cameras.
        state: fields of the state, without an arm's prefix; None if that is not known.
        instructions: those of the script; empty if it reads none.
    """

    cameras: list[str]
    state: list[str] | None
    instructions: list[str]


class Search:
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
        self._probe = probe
        self._manifest = probe.package.manifest
        self._judgement = judgement
        self._course = Course(judgement.session)
        self._config = overrides(judgement.session, settings)
        self._until = time.monotonic() + min(seconds, probe.options.clock.left)

    def run(self) -> Found | None:
        """Return the change that explains the difference best, None if none lowers it.

        A word of the block is preferred to a change around the adapter that does the same.
        """
        found: list[Found] = []
        self._unseen: list[Pattern] = []
        for family in (self._by_block, self._by_commands, self._by_encodings, self._by_shown):
            explanation = family()
            if explanation is None:
                continue
            found.append(Found(explanation, in_block=family == self._by_block))
            if explanation.cause is not None:
                return found[-1]
        near = [one for one in found if one.explanation.near is not None]
        best = next((one for one in (*near, *found) if one.explanation.text), found[0])
        judgement = self._judgement
        told = (
            *self._unseen,
            *places(self._threads, judgement.shares, judgement.tolerance),
            *patterns(self._threads, judgement.spread, judgement.tolerance, self._kind),
        )
        explanation = replace(best.explanation, patterns=told)
        return Found(explanation, best.in_block) if explanation.text else None

    # -- words of the block --------------------------------------------------------------------------------------------

    def _by_block(self) -> Explanation | None:
        """Return what other words of the block explain; None where the adapter does not convert by it alone."""
        session, package = self._judgement.session, self._probe.package
        if not self._model_io:
            return None
        chunk = self._manifest.temporal.chunk
        folders = checkpoint.folders(self._settled, package.path)
        try:
            changes = list(
                alternatives(self._model_io.data, session.robot, session.action_type, folders, chunk, self._templates)
            )
        except ConversionError:
            return None
        converts_by_it = True
        again = Changed(self._probe, self._course, self._settled)
        contest = Contest(self._course, self._judgement, self._course.everything)

        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[Tried]:
            nonlocal converts_by_it
            tried = [self._model_io.data, *(changes[number].block for number in chosen)]
            found = again.blocks(tried, wanted, self._left)
            converts_by_it = converts_by_it and found is not None
            for number, given in zip(chosen, (found or [])[1:], strict=False):
                yield Tried(changes[number].words, changes[number].convention, contest.remaining(given))

        explained = contest.held(len(changes), ask)
        return explained if converts_by_it else None

    # -- changes around the adapter ------------------------------------------------------------------------------------

    def _by_commands(self) -> Explanation:
        """Return what changes of the answers that are known explain."""
        changes = [signal for signal in self._signals if signal.shown is None]
        around = Around(self._course, self._judgement.given)
        contest = Contest(self._course, self._judgement, self._course.everything)
        found = contest.held(len(changes), self._asking(around, changes, contest))
        if found.cause is not None:
            return found
        judgement = self._judgement
        line = fitted(self._threads, judgement.shares, judgement.spread, judgement.tolerance)
        fits = [] if line is None else [line]
        fits += rigid(self._threads, judgement.shares, judgement.spread, judgement.tolerance, self._tool)
        fit = contest.explained(fits)
        return fit if fit.cause is not None or (fit.partial and not found.partial) else found

    @property
    def _tool(self) -> np.ndarray | None:
        """The point between the fingertips in the flange, None where the standard does not know it."""
        try:
            return tool(self._judgement.session.robot)
        except ConversionError:
            return None

    def _by_encodings(self) -> Explanation | None:
        """Return what changes of encoded inputs explain; None if there is no time for them."""
        if self._left <= 0:
            return None
        inputs, session = self._inputs, self._judgement.session
        changes = list(
            encodings(
                session.robot,
                session.action_type,
                pictures=bool(inputs.cameras),
                text=bool(inputs.instructions),
                templates=self._templates,
            )
        )
        again = Changed(self._probe, self._course, self._settled)
        contest = Contest(self._course, self._judgement, self._course.everything)

        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[Tried]:
            # The last family needs time, too; but those that are left of many are near the mistake.
            share = _MANY if len(chosen) == len(changes) else _FEW
            answered = again.encodings([changes[number] for number in chosen], wanted, share * self._left)
            for one in answered:
                tried = Tried(one.words, one.convention, contest.remaining(one.given))
                yield self._both_ways(tried, one.given) if len(wanted) == len(self._course.everything) else tried

        found = contest.held(len(changes), ask)
        if found.cause is None and again.draws == 0 and self._kind.draws:
            self._unseen.append(Pattern("the adapter draws no number, and the model samples", "sampling"))
        return found

    def _both_ways(self, tried: Tried, given: Mapping[int, Chunk] | None) -> Tried:
        """Return a change of what goes in, with the line that what comes out is then of the golden answers, if any."""
        judgement = self._judgement
        if given is None or max(tried.remaining.values()) <= judgement.tolerance:
            return tried
        threads = self._threads_of([given[number] for number in self._course.everything])
        line = fitted(threads, tried.remaining, judgement.spread, judgement.tolerance)
        return tried if line is None else Tried(f"{tried.words}, both ways", tried.convention, line.remaining)

    def _by_shown(self) -> Explanation | None:
        """Return what changes of what is shown explain; None if the adapter cannot be served for it."""
        shown = Shown(self._probe, self._course, self._judgement, self._config, repeats=self._repeats)
        changes = [signal for signal in self._signals if signal.shown is not None]
        try:
            found = shown.explained(changes, self._asking, self._inputs.cameras, self._until)
        except (NotRun, ClientError):
            return None
        self._unseen += shown.patterns
        return found

    @property
    def _kind(self) -> Kind:
        return Kind(
            keeps_state=bool(self._model_io.recurrent) or self._manifest.temporal.kind == "memory",
            history=self._manifest.reach,
            draws=self._draws or "sampling" in self._named,
        )

    @functools.cached_property
    def _templates(self) -> list[str]:
        """The templates of instructions that reference.py or its source writes."""
        return templates(self._probe.package.path)

    @functools.cached_property
    def _named(self) -> Collection[str]:
        """The conventions that reference.py names."""
        try:
            return reading.read_file(self._probe.package.path).conventions
        except UserError:
            return ()

    def _asking(self, around: Around, changes: Sequence[Signal], contest: Contest) -> Ask:
        """Return what tries changes; those that are less likely than one that leaves nothing are not tried."""

        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[Tried]:
            explained: int | None = None
            for number in chosen:
                signal = changes[number]
                if self._left <= 0 or (explained is not None and signal.rank > explained):
                    return
                tried = Tried(signal.words, signal.convention, contest.remaining(around.answers(signal, wanted)))
                if explained is None and max(tried.remaining.values()) <= self._judgement.tolerance:
                    explained = signal.rank
                yield tried

        return ask

    @functools.cached_property
    def _settled(self) -> Config:
        """The values of deploy.yml after all overrides."""
        return self._probe.package.config({**self._probe.options.overrides, **self._config})

    @functools.cached_property
    def _threads(self) -> list[Thread]:
        return self._threads_of(self._judgement.given)

    def _threads_of(self, given: Sequence[Chunk]) -> list[Thread]:
        """Return the episodes of each environment, with some answers."""
        questions, judgement = self._judgement.session.questions, self._judgement
        return [
            Thread(
                self._course.seen(questions[episode[-1]]),
                [questions[number].asked[-1] for number in episode],
                [judgement.golden[number] for number in episode],
                [given[number] for number in episode],
            )
            for episode in self._course.episodes(self._course.everything)
        ]

    @functools.cached_property
    def _inputs(self) -> _Inputs:
        """What the adapter reads, everything if it does not say that."""
        read = list(self._manifest.read)
        shown = [self._course.observation(*question.shown[-1]) for question in self._judgement.session.questions]
        texts = sorted({obs[sdk.Obs.INSTRUCTION] for obs in shown})
        if not read:
            return _Inputs(list(self._judgement.session.cameras), None, texts)
        cameras, fields = (
            [name.partition(".")[2] for name in read if name.startswith(f"{group}.")]
            for group in (sdk.Obs.VISION, sdk.Obs.STATE)
        )
        return _Inputs(cameras, fields, texts if sdk.Obs.INSTRUCTION in read else [])

    @functools.cached_property
    def _signals(self) -> list[Signal]:
        session, history, inputs = self._judgement.session, self._model_io.longest, self._inputs
        found = signals(
            session.robot,
            session.action_type,
            cameras=inputs.cameras,
            reads=inputs.state,
            history=self._manifest.reach if history is None else history.length,
            stride=1 if history is None else history.stride,
            instructions=inputs.instructions,
        )
        return list(found)

    # -- both ----------------------------------------------------------------------------------------------------------

    @property
    def _model_io(self) -> ModelIO:
        return self._manifest.model_io or ModelIO()

    @property
    def _repeats(self) -> bool:
        """Whether a reset is enough between two plays: the model draws nothing, or nothing that could be had again."""
        return is_free(self._manifest) or not self._draws

    @property
    def _draws(self) -> bool:
        """Whether the adapter says that its model draws."""
        return not self._manifest.deterministic or self._model_io.draws

    @property
    def _left(self) -> float:
        return max(0.0, self._until - time.monotonic())
