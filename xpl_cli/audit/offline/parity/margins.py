"""By how much known mistakes would have shown, had a right adapter made them: what its pairs determine, and what not.

Single changes of the block, or of commands where code converts, are asked on all questions, the likeliest first, as far
as the time reaches. A change that moves no answer beyond the tolerance is one that the pairs do not tell apart.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.audit.offline.search.mistake_families import MistakeFamilies
from xpl_cli.audit.offline.search.replay import overrides
from xpl_cli.audit.offline.search.session_replay import SessionReplay
from xpl_cli.model_io.difference import differences

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl_cli.audit.offline.parity.judgement import Judgement
    from xpl_cli.audit.offline.search.ranking import MistakeFamily
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.model_io.difference import Step

MARGIN_S: Final = 20.0
"""Seconds that answers under changes may take, loading not counted."""
_MOST: Final = 120
"""Changes that are tried at most."""


@dataclass(frozen=True)
class MistakeMargin:
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


def measure_margins(probe: Probe, judged: Judgement, settings: Mapping[str, object]) -> list[MistakeMargin]:
    """Return how clearly known mistakes would show in the pairs of one session, in the order of their likelihood.

    Args:
        probe: the adapter, whose answers are the golden ones.
        judged: these answers.
        settings: keys of deploy.yml that the pairs were recorded with.
    """
    course = SessionReplay(judged.session)
    ways = MistakeFamilies(probe, course, overrides(judged.session, settings), time.monotonic() + MARGIN_S)
    with ways.loaded:
        family = ways.block_family()
        found = [] if family is None else list(_margins_of_family(family, judged, course))
    if found:
        return found
    commands = ways.action_family(dict(enumerate(judged.answers)), lambda _answered: False)
    return list(
        _margins_of_family(
            replace(commands, mistakes=[one for one in commands.mistakes if one.rank <= 1]), judged, course
        )
    )


def _margins_of_family(family: MistakeFamily, judged: Judgement, course: SessionReplay) -> Iterator[MistakeMargin]:
    """Yield how clearly each mistake of a family would show."""
    chosen = range(min(_MOST, len(family.mistakes)))
    for answered in family.answers(chosen, course.all_questions):
        if answered.answers is not None:
            yield _measure_margin(judged, answered.words, answered.convention, answered.answers)


def summarize_margins(shown: Sequence[MistakeMargin], pairs: int) -> dict[str, Any]:
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


def _measure_margin(
    judged: Judgement, words: str, convention: str, given: Mapping[int, Sequence[Step | None]]
) -> MistakeMargin:
    def times(numbers: Sequence[int]) -> float:
        shares = differences([judged.golden[one] for one in numbers], [given[one] for one in numbers], judged.spread)
        return max(share / judged.allowed[part] for part, share in shares.items())

    numbers = sorted(given)
    return MistakeMargin(words, convention, times(numbers), sum(times([number]) > 1 for number in numbers))
