"""By how much known mistakes would have shown, had a right adapter made them: what its pairs determine, and what not.

Single changes of the block, or of commands where code converts, are asked on all questions, the likeliest first, as far
as the time reaches. A change that moves no answer beyond the tolerance is one that the pairs do not tell apart.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from xpl import checkpoint
from xpl.convert import ConversionError
from xpl.manifest import ModelIO
from xpl_cli.audit.offline.parity.around import Around
from xpl_cli.audit.offline.parity.changed import Changed
from xpl_cli.audit.offline.parity.course import Course
from xpl_cli.audit.offline.parity.played import overrides
from xpl_cli.model_io.alternatives.block import alternatives
from xpl_cli.model_io.alternatives.signals import signals
from xpl_cli.model_io.difference import differences

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl_cli.audit.offline.parity.judgement import Judgement
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
    found = list(_of_block(probe, judged, course, settings))
    return found or list(_of_commands(probe, judged, course))


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


def _of_block(probe: Probe, judged: Judgement, course: Course, settings: Mapping[str, object]) -> Iterator[Shown]:
    """Yield what other words of the block would come to; nothing where the adapter does not convert by it alone."""
    package, session = probe.package, judged.session
    block = package.manifest.model_io or ModelIO()
    if not block:
        return
    settled = package.config({**probe.options.overrides, **overrides(session, settings)})
    folders = checkpoint.folders(settled, package.path)
    try:
        every = alternatives(block.data, session.robot, session.action_type, folders, package.manifest.temporal.chunk)
        changes = [one for one, _ in zip(every, range(_MOST), strict=False)]
    except ConversionError:
        return
    again = Changed(probe, course, settled)
    found = again.blocks([block.data, *(one.block for one in changes)], course.everything, MARGIN_S)
    for change, given in zip(changes, (found or [])[1:], strict=False):
        if given is not None:
            yield _shown(judged, change.words, change.convention, given)


def _of_commands(probe: Probe, judged: Judgement, course: Course) -> Iterator[Shown]:
    """Yield what changes of commands would come to, which ask the model nothing."""
    manifest, session = probe.package.manifest, judged.session
    around = Around(course, judged.given)
    until = time.monotonic() + MARGIN_S
    for one in signals(session.robot, session.action_type, history=manifest.reach):
        if one.shown is not None or one.rank > 1 or time.monotonic() > until:
            continue
        given = around.answers(one, course.everything)
        if given is not None:
            yield _shown(judged, one.words, one.convention, given)


def _shown(judged: Judgement, words: str, convention: str, given: Mapping[int, Sequence[Step | None]]) -> Shown:
    def times(numbers: Sequence[int]) -> float:
        shares = differences([judged.golden[one] for one in numbers], [given[one] for one in numbers], judged.spread)
        return max(share / judged.allowed[part] for part, share in shares.items())

    numbers = sorted(given)
    return Shown(words, convention, times(numbers), sum(times([number]) > 1 for number in numbers))
