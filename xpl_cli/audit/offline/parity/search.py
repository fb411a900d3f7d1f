"""Which single change explains that an adapter's answers differ from the native ones.

Two families of changes are tried (`xpl_cli.native.alternatives`): other words of the native block, where the adapter
converts by its block alone; and changes around the served adapter, of what it is shown and of what it commands, for
conversions in code. First on one question, then what looks good on a few, and on all of them. The time is bounded: a
finding without a cause is still a finding.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl.client import ClientError
from xpl.convert import NativeError
from xpl_cli.audit.offline.parity import blocks
from xpl_cli.audit.offline.parity.around import Around
from xpl_cli.audit.offline.parity.course import Course
from xpl_cli.audit.offline.parity.played import overrides
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.native.alternatives.block import alternatives
from xpl_cli.native.alternatives.signals import Signal, signals
from xpl_cli.native.difference import differences
from xpl_cli.native.explain import Explanation, Tried, explain
from xpl_cli.native.record import span

if TYPE_CHECKING:
    from xpl_cli.audit.offline.parity.judgement import Judgement
    from xpl_cli.audit.served.probe import Probe


SEARCH_S: Final = 60.0
"""Longest search, s."""
_FEW: Final = 3
"""Questions on which changes are tried before they are on all."""
_MOST: Final = (24, 8, None)
"""Changes that go on, of those tried on one question, on a few and on all: so many that leave least, or mend most."""
_PROMISING: Final = 0.5
"""Share of the difference that a change may leave to be tried on all questions."""
_INFINITE: Final = float("inf")


@dataclass(frozen=True)
class Found:
    """What a search came to.

    Attributes:
        explanation: the best single change.
        in_block: whether it is a word of the native block.
    """

    explanation: Explanation
    in_block: bool


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
        by_block = self._by_block() if self._native else None
        if by_block is not None and by_block.cause is not None:
            return Found(by_block, in_block=True)
        by_signal = self._by_signals()
        if by_signal is not None and by_signal.cause is not None:
            return Found(by_signal, in_block=False)
        for found, in_block in ((by_block, True), (by_signal, False)):
            if found is not None and found.text:
                return Found(found, in_block)
        return None

    # -- words of the block --------------------------------------------------------------------------------------------

    def _by_block(self) -> Explanation | None:
        """Return what other words of the block explain; None where the adapter does not convert by it alone."""
        session, package = self._judgement.session, self._probe.package
        chunk = (self._manifest.get("temporal") or {}).get("chunk")
        try:
            changes = list(alternatives(self._native, session.robot, session.action_type, [package.path], chunk))
        except NativeError:
            return None
        converts_by_it = True

        def asked(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[Tried]:
            nonlocal converts_by_it
            tried = [self._native, *(changes[number].block for number in chosen)]
            found = blocks.answers(self._probe, self._course, self._config, tried, wanted, self._left)
            converts_by_it = found is not None
            for number, given in zip(chosen, (found or [])[1:], strict=False):
                yield Tried(changes[number].words, changes[number].convention, self._remaining(given))

        explained = self._staged(len(changes), asked)
        return explained if converts_by_it else None

    # -- changes around the adapter ------------------------------------------------------------------------------------

    def _by_signals(self) -> Explanation | None:
        """Return what changes of what is shown and commanded explain; None if the adapter cannot be served for it."""
        changes = list(self._signals())
        try:
            flags = [] if self._repeats else ["--renew"]
            with ExitStack() as opened, self._probe.own_server(self._config, flags) as server:
                around = opened.enter_context(
                    Around(
                        self._course,
                        self._judgement.given,
                        lambda: self._probe.connected(server.url),
                        once=self._repeats,
                    )
                )

                def asked(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[Tried]:
                    for number in chosen:
                        if self._left <= 0:
                            return
                        signal = changes[number]
                        given = around.answers(signal, wanted)
                        yield Tried(signal.words, signal.convention, self._remaining(given))

                return self._staged(len(changes), asked)
        except (NotRun, ClientError):
            return None

    def _signals(self) -> Iterator[Signal]:
        inputs = self._manifest.get("inputs") or {}
        read = [*(inputs.get("required") or ()), *(inputs.get("optional") or ())]
        session, history = self._judgement.session, self._native.get("history") or {}
        shown = [self._course.observation(*question.shown[-1]) for question in session.questions]
        texts = sorted({obs[sdk.Obs.INSTRUCTION] for obs in shown})
        pictures = [name.partition(".")[2] for name in read if name.startswith(f"{sdk.Obs.VISION}.")]
        yield from signals(
            session.robot,
            session.action_type,
            cameras=pictures if read else list(session.cameras),
            history=history.get("length") or span(self._manifest),
            stride=history.get("stride", 1),
            instructions=texts if sdk.Obs.INSTRUCTION in read or not read else (),
        )

    # -- both ----------------------------------------------------------------------------------------------------------

    @property
    def _native(self) -> Mapping[str, Any]:
        return self._manifest.get("native") or {}

    @property
    def _repeats(self) -> bool:
        """Whether an episode that is played again has the same answers, so that a reset is enough between two."""
        return bool(self._manifest.get("deterministic", True)) and self._native.get("sampling", "none") == "none"

    @property
    def _left(self) -> float:
        return max(0.0, self._until - time.monotonic())

    def _staged(self, count: int, asked: Callable[[Sequence[int], Sequence[int]], Iterator[Tried]]) -> Explanation:
        """Try changes on a few questions, the best of them on all, and return what explains the difference.

        Args:
            count: number of changes.
            asked: tries changes by their numbers on questions by theirs, as far as the time reaches.
        """
        good: Sequence[int] = range(count)
        tried: list[Tried] = []
        for wanted, most in zip((self._chosen[:1], self._chosen, self._course.everything), _MOST, strict=True):
            tried = list(asked(good, wanted)) if good else []
            if most is not None:
                good = [good[place] for place in self._promising(tried, wanted, most)]
        return explain(self._judgement.shares, tried, self._judgement.tolerance)

    @cached_property
    def _chosen(self) -> list[int]:
        """The questions on which changes are tried first: one that tells much, one that is right, another one."""
        judgement = self._judgement
        worst = {
            number: max(self._remaining({number: judgement.given[number]}).values())
            for number in self._course.everything
        }
        wrong = [number for number, is_off in enumerate(judgement.off) if is_off]
        right = [number for number, is_off in enumerate(judgement.off) if not is_off]
        largest = max(worst[number] for number in wrong)
        telling = [number for number in wrong if worst[number] >= _PROMISING * largest]
        return list(dict.fromkeys([telling[0], *right[:1], *telling[1:], *wrong]))[:_FEW]

    def _promising(self, tried: Sequence[Tried], wanted: Sequence[int], most: int) -> list[int]:
        """Return the places of the changes that are worth more questions: that leave least, or mend most numbers."""
        judgement = self._judgement
        before = self._remaining({number: judgement.given[number] for number in self._course.with_earlier(wanted)})
        largest = max(before.values())
        left = [max(one.remaining.values()) / largest if largest < _INFINITE else _INFINITE for one in tried]
        mended = [
            sum(value > judgement.allowed[part] >= one.remaining[part] for part, value in before.items())
            for one in tried
        ]
        worth = [place for place in range(len(tried)) if left[place] <= _PROMISING or mended[place]]
        best = sorted(worth, key=lambda place: left[place])[:most]
        widest = sorted(worth, key=lambda place: -mended[place])[:most]
        return sorted({*best, *widest})

    def _remaining(self, given: Mapping[int, Sequence[Any]] | None) -> dict[str, float]:
        """Return how far answers to some questions are from the native ones; steps that are not known do not count."""
        judgement = self._judgement
        native, other = [], []
        for number, chunk in (given or {}).items():
            wanted = judgement.native[number]
            known = [place for place, step in enumerate(chunk) if step is not None and place < len(wanted)]
            native.append([wanted[place] for place in known])
            other.append([chunk[place] for place in known])
            if len(chunk) != len(wanted):
                return dict.fromkeys(judgement.spread, _INFINITE)
        if not any(native):
            return dict.fromkeys(judgement.spread, _INFINITE)
        return differences(native, other, judgement.spread)
