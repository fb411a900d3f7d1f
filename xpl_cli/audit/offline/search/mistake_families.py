"""The ways in which an adapter's answers under mistakes are had, each as a family of mistakes.

As other words of the model_io block and as changes of encoded inputs, in a process that loads the model once; as
changes of what is shown, by a server; as changes of the commands that are known already.
"""

from __future__ import annotations

import functools
import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from xpl import checkpoint
from xpl.catalogue import AdapterCase, Mistake
from xpl.catalogue import convention as catalogue
from xpl.convert import ConversionError
from xpl.manifest import ModelIO
from xpl_cli.audit.offline.search.loaded_adapter import LoadedAdapter, MistakeAnswers
from xpl_cli.audit.offline.search.perturbed_adapter import PerturbedAdapter
from xpl_cli.audit.offline.search.ranking import AnswerFunction, MistakeFamily
from xpl_cli.model_io import mistakes
from xpl_cli.model_io.prompts import templates

if TYPE_CHECKING:
    from xpl.contract import Config
    from xpl_cli.audit.offline.search.session_replay import SessionReplay
    from xpl_cli.audit.served.probe import Probe

_MANY: Final = 0.45
_FEW: Final = 0.9
"""Shares of the time that is left for changes of encoded inputs: of all, and of those that lower the difference."""

_ALONE: Final = frozenset(("drawn", "once"))
"""Kinds of changes of encoded inputs that are made of all that a model does."""
_LITTLE_S: Final = 15.0
"""What the search for two mistakes may take at least."""

ExplainsAll = Callable[[MistakeAnswers], bool]
"""Tells whether answers leave nothing to explain, so that what is less likely need not be tried."""


@dataclass(frozen=True)
class ReadInputs:
    """What an adapter reads, of what the questions show.

    Attributes:
        cameras: names of cameras.
        state: fields of the state, without an arm's prefix; None if that is not known.
        texts: the instructions; empty if it reads none.
    """

    cameras: Sequence[str]
    state: Sequence[str] | None
    texts: Sequence[str]


_NOTHING: Final = ReadInputs((), None, ())


class MistakeFamilies:
    """One adapter and the questions that it is asked under mistakes.

    Args:
        probe: the adapter.
        course: the questions.
        settings: keys of deploy.yml that it is served with for them.
        until: when to end, by the monotonic clock.
        read: what it reads.
    """

    def __init__(
        self,
        probe: Probe,
        course: SessionReplay,
        settings: Mapping[str, object],
        until: float,
        read: ReadInputs = _NOTHING,
    ) -> None:
        self._course, self._until = course, until
        self._began = time.monotonic()
        package = probe.package
        self.manifest = package.manifest
        self.model_io = self.manifest.model_io or ModelIO()
        self.config: Config = package.config({**probe.options.overrides, **settings})
        history = self.model_io.longest
        self.case = AdapterCase(
            embodiment=course.session.robot,
            action_type=course.session.action_type,
            block=self.model_io.data if self.model_io else {},
            folders=checkpoint.folders(self.config, package.path),
            templates=templates(package.path),
            history=self.manifest.reach if history is None else history.length,
            stride=1 if history is None else history.stride,
            cameras=read.cameras,
            reads=read.state,
            instructions=read.texts,
        )
        self.loaded = LoadedAdapter(probe, course, self.config, self.case.block)
        self.by_block = bool(self.case.block)
        """Whether the block says how the adapter converts, as far as that is known."""

    @property
    def seconds_left(self) -> float:
        """Seconds that are left."""
        return max(0.0, self._until - time.monotonic())

    def halve_time(self) -> None:
        """Leave no more time than was used, and a little for what is quick."""
        now = time.monotonic()
        self._until = min(self._until, now + max(_LITTLE_S, now - self._began))

    # -- the block -----------------------------------------------------------------------------------------------------

    def block_family(
        self, wanted: Callable[[Mistake], bool] = lambda _one: True, enough: ExplainsAll = lambda _answered: False
    ) -> MistakeFamily | None:
        """Return other words of the block; None where there is none that fits.

        Args:
            wanted: tells which are tried.
            enough: of all of them, what is less likely than one for which this holds is not asked.
        """
        if self._block_mistakes is None:
            return None
        return self._family_of_blocks([pair for pair in self._block_mistakes if wanted(pair[0])], enough=enough)

    @functools.cached_property
    def _block_mistakes(self) -> list[tuple[Mistake, dict[str, Any]]] | None:
        """The mistakes as other words of the block, each with the block that it makes; each was compiled once."""
        if not self.case.block:
            return None
        try:
            return list(mistakes.in_block(self.case, self.manifest.temporal.chunk))
        except ConversionError:
            return None

    def _family_of_blocks(
        self,
        found: Sequence[tuple[Mistake, Mapping[str, Any]]],
        numbers: Sequence[tuple[int, int]] = (),
        enough: ExplainsAll = lambda _answered: False,
    ) -> MistakeFamily:
        def asked(chosen: Sequence[int], wanted: Sequence[int]) -> list[MistakeAnswers]:
            answers = self.loaded.answers_by_block([found[number][1] for number in chosen], wanted, self.seconds_left)
            self.by_block = self.by_block and answers is not None
            named = [(found[number][0].description, found[number][0].convention) for number in chosen]
            return [MistakeAnswers(*one, given) for one, given in zip(named, answers or [], strict=False)]

        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[MistakeAnswers]:
            if len(chosen) < len(found):
                yield from asked(chosen, wanted)
                return
            for _, several in itertools.groupby(chosen, lambda number: found[number][0].rank):
                numbers = list(several)
                told = asked(numbers, wanted)
                yield from told
                if len(told) < len(numbers) or any(map(enough, told)):
                    return

        def both(pairs: Sequence[tuple[int, int]]) -> MistakeFamily:
            named, made = [], []
            for one, other in pairs:
                edits = {**(found[one][0].edits or {}), **(found[other][0].edits or {})}
                if len(edits) == sum(len(found[place][0].edits or {}) for place in (one, other)):
                    named.append((one, other))
                    made.append(replace(found[one][0], edits=edits))
            fit = dict(mistakes.fitting_blocks(self.case, made, self.manifest.temporal.chunk))
            kept = sorted(fit)
            return self._family_of_blocks(
                [(made[place], fit[place]) for place in kept], [named[place] for place in kept]
            )

        return MistakeFamily([mistake for mistake, _ in found], ask, both, numbers)

    # -- around the adapter --------------------------------------------------------------------------------------------

    @functools.cached_property
    def outer_mistakes(self) -> list[Mistake]:
        """The mistakes as changes around the adapter."""
        return list(catalogue.io_mistakes(self.case))

    def action_family(self, given: Mapping[int, Sequence[Any]], enough: ExplainsAll) -> MistakeFamily:
        """Return changes of answers that are known."""
        found = [one for one in self.outer_mistakes if one.change_observations is None]
        around = PerturbedAdapter(self._course, given)
        return MistakeFamily(found, self.answer_function(around, found, enough))

    def answer_function(
        self, around: PerturbedAdapter, found: Sequence[Mistake], enough: ExplainsAll
    ) -> AnswerFunction:
        """Return what asks under changes around an adapter, until what is less likely need not be tried."""

        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[MistakeAnswers]:
            explained: int | None = None
            for number in chosen:
                one = found[number]
                if self.seconds_left <= 0 or (explained is not None and one.rank > explained):
                    return
                answered = MistakeAnswers(one.description, one.convention, around.answers(one, wanted))
                if explained is None and enough(answered):
                    explained = one.rank
                yield answered

        return ask

    # -- encoded inputs ------------------------------------------------------------------------------------------------

    def input_family(self) -> MistakeFamily:
        """Return changes of what the adapter's own `encode` makes."""
        return self._family_of_inputs(list(catalogue.input_mistakes(self.case)))

    def _family_of_inputs(self, found: Sequence[Mistake], numbers: Sequence[tuple[int, int]] = ()) -> MistakeFamily:
        def ask(chosen: Sequence[int], wanted: Sequence[int]) -> Iterator[MistakeAnswers]:
            # The last family needs time, too; but those that are left of many are near the mistake.
            share = _MANY if len(chosen) == len(found) else _FEW
            yield from self.loaded.answers_by_input_change(
                [found[number] for number in chosen], wanted, share * self.seconds_left
            )

        def both(pairs: Sequence[tuple[int, int]]) -> MistakeFamily:
            kept, made = [], []
            for one, other in pairs:
                hows = [found[place].input_change or {} for place in (one, other)]
                if len({how["kind"] for how in hows}) == len(hows) and not _ALONE & {how["kind"] for how in hows}:
                    kept.append((one, other))
                    made.append(replace(found[one], input_change={"kind": "several", "of": hows}, geometry=""))
            return self._family_of_inputs(made, kept)

        return MistakeFamily(found, ask, both, numbers)
