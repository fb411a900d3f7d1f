"""An adapter's answers where what its own `encode` makes is changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.audit.offline.parity.changed import replayed
from xpl_cli.native.alternatives.encodings import convention_of

if TYPE_CHECKING:
    from xpl_cli.audit.offline.parity.course import Course
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.native.alternatives.encodings import Encoding
    from xpl_cli.native.pairs import Chunk


@dataclass(frozen=True)
class Answered:
    """What an adapter answers with a change.

    Attributes:
        words, convention: of the change, as well as they are known now.
        given: by number of a question its answer; None where the change has no meaning here.
    """

    words: str
    convention: str
    given: dict[int, Chunk] | None


class Encoded:
    """Tries changes of encoded inputs in a process of the adapter's interpreter.

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

    def answers(self, changes: Sequence[Encoding], wanted: Sequence[int], seconds: float) -> list[Answered]:
        """Return the answers to some questions under each change, as far as the time reaches.

        Nothing, if the adapter does not derive from `xpl.Policy`, or cannot be loaded there.
        """
        how = {"changes": [dict(change.how) for change in changes]}
        found = replayed(self._probe, self._course, self._config, "xpl.worker.encoded.play", how, wanted, seconds)
        tried = list(zip(changes, found or [], strict=False))
        sizes = [(told["apart"], change.geometry) for change, told in tried if told and change.geometry]
        least = min(sizes, default=(0.0, ""))[0]
        # Of the first, which were all; with some pictures several geometries are one.
        self._nearest = self._nearest or {geometry for apart, geometry in sizes if apart <= least}
        self.draws = next((told["draws"] for _, told in tried if told and "draws" in told), self.draws)
        numbers = self._course.with_earlier(wanted)
        return [
            Answered(
                (told or {}).get("words", change.words),
                convention_of(change, self._nearest),
                dict(zip(numbers, told["answers"], strict=True)) if told else None,
            )
            for change, told in tried
        ]
