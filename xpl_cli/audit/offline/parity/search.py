"""Which single change explains that an adapter's answers differ from the native ones.

Families of changes (`xpl_cli.native.alternatives`) are tried one after another until one explains it: other words of
the native block, where the adapter converts by its block alone; for conversions in code, changes of what it commands,
which cost no play, of what its `encode` makes, and of what it is shown. The time is bounded: a finding without a cause
is still a finding.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl import checkpoint
from xpl.client import ClientError
from xpl.convert import NativeError
from xpl_cli.audit.offline.parity import blocks
from xpl_cli.audit.offline.parity.around import Around
from xpl_cli.audit.offline.parity.contest import Ask, Contest
from xpl_cli.audit.offline.parity.course import Course
from xpl_cli.audit.offline.parity.encoded import Encoded
from xpl_cli.audit.offline.parity.played import overrides
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.native.alternatives.block import alternatives
from xpl_cli.native.alternatives.encodings import encodings
from xpl_cli.native.alternatives.signals import Signal, signals
from xpl_cli.native.alternatives.signals.pictures import dark
from xpl_cli.native.difference import Thread, differences
from xpl_cli.native.explain import Explanation, Tried
from xpl_cli.native.fitted import fitted
from xpl_cli.native.patterns import Kind, Pattern, patterns
from xpl_cli.native.record import is_free, span

if TYPE_CHECKING:
    from xpl_cli.audit.offline.parity.judgement import Judgement
    from xpl_cli.audit.served.probe import Probe


SEARCH_S: Final = 60.0
"""Longest search, s."""


_APART: Final = Signal(
    0, "each environment asked by itself", "recurrent", shown=lambda seen: [dict(obs) for obs in seen]
)
"""Changes nothing of what is shown."""


@dataclass(frozen=True)
class Found:
    """What a search came to.

    Attributes:
        explanation: the best single change.
        in_block: whether it is a word of the native block.
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
        self, probe: Probe, judgement: Judgement, settings: Mapping[str, Any], seconds: float = SEARCH_S
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
        best = next((one for one in found if one.explanation.text), found[0])
        told = (*self._unseen, *patterns(self._threads, self._judgement.spread, self._judgement.tolerance, self._kind))
        explanation = replace(best.explanation, patterns=told)
        return Found(explanation, best.in_block) if explanation.text else None

    # -- words of the block --------------------------------------------------------------------------------------------

    def _by_block(self) -> Explanation | None:
        """Return what other words of the block explain; None where the adapter does not convert by it alone."""
        session, package = self._judgement.session, self._probe.package
        if not self._native:
            return None
        chunk = (self._manifest.get("temporal") or {}).get("chunk")
        config = package.config({**self._probe.options.overrides, **self._config})
        folders = checkpoint.folders(config, package.path)
        try:
            changes = list(alternatives(self._native, session.robot, session.action_type, folders, chunk))
        except NativeError:
            return None
        converts_by_it = True

        contest = Contest(self._course, self._judgement, self._course.everything)

        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[Tried]:
            nonlocal converts_by_it
            tried = [self._native, *(changes[number].block for number in chosen)]
            found = blocks.answers(self._probe, self._course, self._config, tried, wanted, self._left)
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
        return found if line is None else contest.explained([line])

    def _by_encodings(self) -> Explanation | None:
        """Return what changes of encoded inputs explain; None if there is no time for them."""
        if self._left <= 0:
            return None
        inputs, session = self._inputs, self._judgement.session
        has = {"pictures": bool(inputs.cameras), "text": bool(inputs.instructions)}
        changes = list(encodings(session.robot, session.action_type, **has))
        encoded = Encoded(self._probe, self._course, self._config)
        contest = Contest(self._course, self._judgement, self._course.everything)

        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[Tried]:
            # No more than half of the time: the last family needs some, too.
            answered = encoded.answers([changes[number] for number in chosen], wanted, self._left / 2)
            for one in answered:
                yield Tried(one.words, one.convention, contest.remaining(one.given))

        return contest.held(len(changes), ask)

    def _by_shown(self) -> Explanation | None:
        """Return what changes of what is shown explain; None if the adapter cannot be served for it."""
        flags = [] if self._repeats else ["--renew"]
        try:
            with ExitStack() as opened, self._probe.own_server(self._config, flags) as server:
                connect = functools.partial(self._probe.connected, server.url)
                around = Around(self._course, self._judgement.given, connect, once=self._repeats)
                return self._played(opened.enter_context(around))
        except (NotRun, ClientError):
            return None

    def _played(self, around: Around) -> Explanation | None:
        """Return what changes explain that are played one environment at a time, each in an episode of its own.

        That alone may make a difference: then no change of what is shown says anything.
        """
        contest = Contest(self._course, self._judgement, self._replayable)
        if not contest.differs:
            return None
        apart = around.answers(_APART, self._replayable)
        alone = Tried(_APART.words, _APART.convention, contest.remaining(apart))
        same = self._is_as_before(apart)
        changes = [one for one in self._signals if one.shown is not None and same and not self._breaks(one)]
        if not same and contest.explained([alone]).cause is not None:
            return contest.explained([alone])
        found = contest.held(len(changes), self._asking(around, changes, contest))
        if found.cause is None and same:
            self._unseen += self._cameras_without_effect(around)
        return found

    def _cameras_without_effect(self, around: Around) -> Iterator[Pattern]:
        """Tell which cameras may be exchanged for darkness."""
        judgement, number = self._judgement, self._replayable[-1]
        for camera in self._inputs.cameras if self._left > 0 else ():
            answers = around.answers(Signal(0, camera, "camera", dark(camera)), [number])
            if answers is None:
                continue
            far = differences([judgement.given[one] for one in answers], list(answers.values()), judgement.spread)
            if max(far.values()) == 0.0:
                yield Pattern(f"a dark {camera} changes no answer: the model does not see it", "camera")

    @property
    def _kind(self) -> Kind:
        temporal = self._manifest.get("temporal") or {}
        return Kind(
            keeps_state=bool(self._native.get("recurrent")) or temporal.get("kind") == "memory",
            history=span(self._manifest),
            draws=not self._manifest.get("deterministic", True),
        )

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
    def _threads(self) -> list[Thread]:
        """The episodes of each environment."""
        questions, judgement = self._judgement.session.questions, self._judgement
        return [
            Thread(
                self._course.seen(questions[episode[-1]]),
                [questions[number].asked[-1] for number in episode],
                [judgement.native[number] for number in episode],
                [judgement.given[number] for number in episode],
            )
            for episode in self._course.episodes(self._course.everything)
        ]

    @property
    def _replayable(self) -> list[int]:
        """The questions whose answers are the same when they are played again; a model may draw otherwise later."""
        questions = self._judgement.session.questions
        return [question.number for question in questions if self._repeats or question.episode == 0]

    def _is_as_before(self, answers: Mapping[int, Sequence[Any]] | None) -> bool:
        """Tell whether answers to the questions that can be played again are those of the whole session."""
        judgement, numbers = self._judgement, self._replayable
        if answers is None:
            return False
        given = [judgement.given[number] for number in numbers]
        found = differences(given, [answers[number] for number in numbers], judgement.spread)
        return all(share <= judgement.allowed[part] for part, share in found.items())

    def _breaks(self, signal: Signal) -> bool:
        """Tell whether a change leaves out questions, after which a model that draws would draw otherwise."""
        return signal.windowed and not self._repeats

    @functools.cached_property
    def _inputs(self) -> _Inputs:
        """What the adapter reads, everything if it does not say that."""
        inputs = self._manifest.get("inputs") or {}
        read = [*(inputs.get("required") or ()), *(inputs.get("optional") or ())]
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
        session, history, inputs = self._judgement.session, self._native.get("history") or {}, self._inputs
        found = signals(
            session.robot,
            session.action_type,
            cameras=inputs.cameras,
            reads=inputs.state,
            history=history.get("length") or span(self._manifest),
            stride=history.get("stride", 1),
            instructions=inputs.instructions,
        )
        return list(found)

    # -- both ----------------------------------------------------------------------------------------------------------

    @property
    def _native(self) -> Mapping[str, Any]:
        return self._manifest.get("native") or {}

    @property
    def _repeats(self) -> bool:
        """Whether a reset is enough between two plays: the model draws nothing, or nothing that could be had again."""
        draws = not self._manifest.get("deterministic", True) or self._native.get("sampling", "none") != "none"
        return is_free(self._manifest) or not draws

    @property
    def _left(self) -> float:
        return max(0.0, self._until - time.monotonic())
