"""The ways in which an adapter's answers under mistakes are had, each as a family of mistakes.

As other words of the model_io block and as changes of encoded inputs, in a process that loads the model once; as
changes of what is shown, by a server; as changes of the commands that are known already.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from xpl import checkpoint
from xpl.catalogue import Case, Mistake
from xpl.catalogue import convention as catalogue
from xpl.convert import ConversionError
from xpl.manifest import ModelIO
from xpl_cli.audit.offline.search.around import Around
from xpl_cli.audit.offline.search.contest import Ask, Family
from xpl_cli.audit.offline.search.loaded import Answered, Given, LoadedAdapter
from xpl_cli.model_io import mistakes
from xpl_cli.model_io.prompts import templates

if TYPE_CHECKING:
    from xpl.contract import Config
    from xpl_cli.audit.offline.search.course import Course
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.model_io.pairs import Chunk

_MANY: Final = 0.45
_FEW: Final = 0.9
"""Shares of the time that is left for changes of encoded inputs: of all, and of those that lower the difference."""

_LITTLE_S: Final = 10.0
"""What the search for two mistakes may take at least."""

Enough = Callable[[Answered], bool]
"""Tells whether answers leave nothing to explain, so that what is less likely need not be tried."""


class Ways:
    """One adapter and the questions that it is asked under mistakes.

    Args:
        probe: the adapter.
        course: the questions.
        settings: keys of deploy.yml that it is served with for them.
        until: when to end, by the monotonic clock.
        inputs: what of the case is known by the questions: cameras, reads, instructions.
    """

    def __init__(
        self, probe: Probe, course: Course, settings: Mapping[str, object], until: float, **inputs: Any
    ) -> None:
        self._course, self._until = course, until
        self._began = time.monotonic()
        package = probe.package
        self.manifest = package.manifest
        self.model_io = self.manifest.model_io or ModelIO()
        self.config: Config = package.config({**probe.options.overrides, **settings})
        history = self.model_io.longest
        self.case = Case(
            embodiment=course.session.robot,
            action_type=course.session.action_type,
            block=self.model_io.data if self.model_io else {},
            folders=checkpoint.folders(self.config, package.path),
            templates=templates(package.path),
            history=self.manifest.reach if history is None else history.length,
            stride=1 if history is None else history.stride,
            **inputs,
        )
        self.loaded = LoadedAdapter(probe, course, self.config, self.case.block)
        self.by_block = bool(self.case.block)
        """Whether the block says how the adapter converts, as far as that is known."""

    @property
    def left(self) -> float:
        """Seconds that are left."""
        return max(0.0, self._until - time.monotonic())

    def halve(self) -> None:
        """Leave no more time than was used, and a little for what is quick."""
        now = time.monotonic()
        self._until = min(self._until, now + max(_LITTLE_S, now - self._began))

    # -- the block -----------------------------------------------------------------------------------------------------

    def block(self, wanted: Callable[[Mistake], bool] = lambda _one: True) -> Family | None:
        """Return other words of the block; None where there is none that fits.

        Args:
            wanted: tells which are tried.
        """
        if not self.case.block:
            return None
        try:
            found = list(mistakes.in_block(self.case, self.manifest.temporal.chunk))
        except ConversionError:
            return None
        return self._of_blocks([pair for pair in found if wanted(pair[0])], self._after_block)

    def _after_block(self, block: Mapping[str, Any]) -> Family:
        """Return what may be wrong besides, where a block is mended already."""
        case = replace(self.case, block=block)
        found = mistakes.in_block(case, self.manifest.temporal.chunk)
        return self._of_blocks([pair for pair in found if pair[1] != self.case.block], None)

    def _of_blocks(
        self,
        pairs: Sequence[tuple[Mistake, dict[str, Any]]],
        after: Callable[[Mapping[str, Any]], Family] | None,
    ) -> Family:
        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[Answered]:
            found = self.loaded.blocks([pairs[number][1] for number in chosen], wanted, self.left)
            self.by_block = self.by_block and found is not None
            for number, given in zip(chosen, found or [], strict=False):
                yield Answered(pairs[number][0].words, pairs[number][0].convention, given)

        return Family(
            [mistake for mistake, _ in pairs], ask, lambda number: None if after is None else after(pairs[number][1])
        )

    # -- around the adapter --------------------------------------------------------------------------------------------

    @functools.cached_property
    def around_it(self) -> list[Mistake]:
        """The mistakes as changes around the adapter."""
        return list(catalogue.around(self.case))

    def commands(self, given: Mapping[int, Sequence[Any]], enough: Enough) -> Family:
        """Return changes of answers that are known."""
        found = [one for one in self.around_it if one.shown is None]
        around = Around(self._course, given)
        return Family(found, self.asking(around, found, enough))

    def asking(self, around: Around, found: Sequence[Mistake], enough: Enough) -> Ask:
        """Return what asks under changes around an adapter, until what is less likely need not be tried."""

        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[Answered]:
            explained: int | None = None
            for number in chosen:
                one = found[number]
                if self.left <= 0 or (explained is not None and one.rank > explained):
                    return
                answered = Answered(one.words, one.convention, around.answers(one, wanted))
                if explained is None and enough(answered):
                    explained = one.rank
                yield answered

        return ask

    # -- encoded inputs ------------------------------------------------------------------------------------------------

    def inputs(self) -> Family:
        """Return changes of what the adapter's own `encode` makes."""
        found = list(catalogue.in_inputs(self.case))
        return self._of_inputs(found, lambda number: self._after_inputs(found, found[number]))

    def _after_inputs(self, found: Sequence[Mistake], first: Mistake) -> Family | None:
        if first.encoded is None or first.encoded["kind"] == "drawn":
            return None
        both = [
            replace(one, encoded={"kind": "several", "of": [first.encoded, one.encoded]}, geometry="")
            for one in found
            if one.encoded is not None and one.encoded["kind"] not in {"drawn", first.encoded["kind"]}
        ]
        return self._of_inputs(both, lambda _number: None)

    def _of_inputs(self, found: Sequence[Mistake], after: Callable[[int], Family | None]) -> Family:
        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[Answered]:
            # The last family needs time, too; but those that are left of many are near the mistake.
            share = _MANY if len(chosen) == len(found) else _FEW
            yield from self.loaded.inputs([found[number] for number in chosen], wanted, share * self.left)

        return Family(found, ask, after)

    def known(self, given: Sequence[Chunk]) -> Given:
        """Return answers to all questions by their numbers."""
        return dict(enumerate(given))
