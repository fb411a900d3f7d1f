"""By how much known mistakes would have shown, had a right adapter made them: what its pairs determine, and what not.

Single changes of the block, or of commands where code converts, are asked on all questions, the likeliest first, as far
as the time reaches. A change that moves no answer beyond the tolerance is one that the pairs do not tell apart.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.audit.offline.search.course import Course
from xpl_cli.audit.offline.search.played import overrides
from xpl_cli.audit.offline.search.ways import Ways
from xpl_cli.model_io.difference import differences

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl_cli.audit.offline.parity.judgement import Judgement
    from xpl_cli.audit.offline.search.contest import Family
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.model_io.difference import Step

MARGIN_S: Final = 20.0
"""Seconds that answers under changes may take, loading not counted."""
_MOST: Final = 120
"""Changes that are tried at most."""


@dataclass(frozen=True)
class Shown:
    """How clearly one mistake would show.

    Attributes:
        words, convention: of the change.
        times: largest difference, as a multiple of what is allowed of that number.
        pairs: questions in which it is above that.
    """

    words: str
    convention: str
    times: float
    pairs: int


def margins(probe: Probe, judged: Judgement, settings: Mapping[str, object]) -> list[Shown]:
    """Return how clearly known mistakes would show in the pairs of one session, in the order of their likelihood.

    Args:
        probe: the adapter, whose answers are the golden ones.
        judged: these answers.
        settings: keys of deploy.yml that the pairs were recorded with.
    """
    course = Course(judged.session)
    ways = Ways(probe, course, overrides(judged.session, settings), time.monotonic() + MARGIN_S)
    with ways.loaded:
        family = ways.block()
        found = [] if family is None else list(_under(family, judged, course))
    if found:
        return found
    commands = ways.commands(dict(enumerate(judged.given)), lambda _answered: False)
    return list(_under(replace(commands, mistakes=[one for one in commands.mistakes if one.rank <= 1]), judged, course))


def _under(family: Family, judged: Judgement, course: Course) -> Iterator[Shown]:
    """Yield how clearly each mistake of a family would show."""
    chosen = range(min(_MOST, len(family.mistakes)))
    for answered in family.ask(chosen, course.everything):
        if answered.given is not None:
            yield _shown(judged, answered.words, answered.convention, answered.given)


def told(shown: Sequence[Shown], pairs: int) -> dict[str, Any]:
    """Return what a verdict says of that: undetermined conventions, and the smallest margin of the others.

    Args:
        shown: of `margins`.
        pairs: how many questions there are.
    """
    seen = {one.convention for one in shown if one.times > 1}
    undetermined = [one.convention for one in shown if one.convention not in seen]
    found: dict[str, Any] = {"undetermined": list(dict.fromkeys(undetermined))}
    clear = [one for one in shown if one.times > 1]
    if clear:
        least = min(clear, key=lambda one: one.times)
        found["margin"] = {
            "words": least.words,
            "times": float(f"{least.times:.2g}"),
            "pairs": least.pairs,
            "of": pairs,
        }
        # A change that the pairs do not tell from the right one, of a convention that they otherwise tell.
        found["unseen"] = [one.words for one in shown if one.times <= 1 and one.convention in seen]
    return found


def _shown(judged: Judgement, words: str, convention: str, given: Mapping[int, Sequence[Step | None]]) -> Shown:
    def times(numbers: Sequence[int]) -> float:
        shares = differences([judged.golden[one] for one in numbers], [given[one] for one in numbers], judged.spread)
        return max(share / judged.allowed[part] for part, share in shares.items())

    numbers = sorted(given)
    return Shown(words, convention, times(numbers), sum(times([number]) > 1 for number in numbers))
