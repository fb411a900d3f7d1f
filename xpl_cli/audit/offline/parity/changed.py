"""An adapter asked again in a process of its interpreter, where the model is loaded once for many changes.

Changes are other words of its model_io block, or of what its own `encode` makes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

from xpl_cli.audit.offline import inprocess
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.isolation import errand
from xpl_cli.model_io.alternatives.encodings import convention_of

if TYPE_CHECKING:
    from xpl.contract import Entry
    from xpl_cli.audit.offline.parity.course import Course
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.model_io.alternatives.encodings import Encoding
    from xpl_cli.model_io.pairs import Chunk

Given = dict[int, "Chunk"]
"""By number of a question its answer."""

_MORE_S = 30.0
"""What loading the model may take besides."""


@dataclass(frozen=True)
class Answered:
    """What an adapter answers with a change of its encoded inputs.

    Attributes:
        words, convention: of the change, as well as they are known now.
        given: the answers; None where the change has no meaning here.
    """

    words: str
    convention: str
    given: Given | None


@dataclass(frozen=True)
class _Told:
    """What `xpl.worker.encoded.play` says of a change; nothing where it has no meaning.

    Attributes:
        answers: of each question.
        words: what the change is, if the process knows better.
        apart: how far pictures are from those before.
        draws: how many times something was drawn.
    """

    answers: Sequence[Chunk] | None = None
    words: str | None = None
    apart: float = 0.0
    draws: int | None = None

    @classmethod
    def read(cls, told: Entry | None) -> Self:
        if told is None:
            return cls()
        return cls(told["answers"], told.get("words"), told.get("apart", 0.0), told.get("draws"))


class Changed:
    """One adapter and the questions that it is asked again.

    Args:
        probe: the adapter.
        course: the questions.
        config: values of deploy.yml after overrides.
    """

    def __init__(self, probe: Probe, course: Course, config: Mapping[str, object]) -> None:
        self._probe, self._course, self._config = probe, course, config
        self._nearest: set[str] = set()
        self.draws: int | None = None
        """How many times numbers are drawn in some answers; None if that is not known."""

    def blocks(self, blocks: Sequence[Entry], wanted: Sequence[int], seconds: float) -> list[Given | None] | None:
        """Return the answers to some questions under each model_io block, as far as the time reaches.

        Args:
            blocks: the first is the adapter's own.
            wanted: numbers of questions.
            seconds: how long it may take.

        Returns:
            None for a block that cannot be used; None in all if the block does not say how the adapter converts, or the
            model cannot be loaded there.
        """
        found = self._replayed("xpl.worker.variants", {"blocks": list(blocks)}, wanted, seconds)
        return found and [None if told is None else self._by_number(told, wanted) for told in found]

    def encodings(self, changes: Sequence[Encoding], wanted: Sequence[int], seconds: float) -> list[Answered]:
        """Return the answers to some questions under each change of encoded inputs, as far as the time reaches.

        Nothing, if the adapter does not derive from `xpl.Policy`, or cannot be loaded there.
        """
        how = {"changes": [dict(change.how) for change in changes]}
        found = self._replayed("xpl.worker.encoded.play", how, wanted, seconds)
        tried = list(zip(changes, map(_Told.read, found or []), strict=False))
        sizes = [(told.apart, change.geometry) for change, told in tried if told.answers and change.geometry]
        least = min(sizes, default=(0.0, ""))[0]
        # Of the first, which were all; with some pictures several geometries are one.
        self._nearest = self._nearest or {geometry for apart, geometry in sizes if apart <= least}
        self.draws = next((told.draws for _, told in tried if told.draws is not None), self.draws)
        return [
            Answered(
                change.words if told.words is None else told.words,
                convention_of(change, self._nearest),
                self._by_number(told.answers, wanted) if told.answers else None,
            )
            for change, told in tried
        ]

    def _by_number(self, answers: Sequence[Chunk], wanted: Sequence[int]) -> Given:
        return dict(zip(self._course.with_earlier(wanted), answers, strict=True))

    def _replayed(
        self, module: str, changes: Mapping[str, Sequence[object]], wanted: Sequence[int], seconds: float
    ) -> list[Any] | None:
        """Return what an errand says of each change, None for one that has no meaning here.

        None in all if it has no use for the adapter, or the model cannot be loaded there.
        """
        order = {
            **inprocess.loading(self._probe),
            "config": self._config,
            **changes,
            "calls": self._course.told(self._course.calls(wanted)),
            "seconds": seconds,
        }
        done = errand.run(module, order, inprocess.place(self._probe, seconds + _MORE_S))
        try:
            found = inprocess.loaded(done)
        except NotRun:
            return None
        return [answer.result for answer in found] if done.answers[0].result is None else None
