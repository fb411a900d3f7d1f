"""An adapter's answers under other words of its native block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from xpl_cli.audit.offline.parity.changed import replayed

if TYPE_CHECKING:
    from xpl_cli.audit.offline.parity.course import Course
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.native.pairs import Chunk

Given = dict[int, "Chunk"]
"""By number of a question its answer."""


def answers(  # noqa: PLR0913, PLR0917 - who, what, how, and for how long
    probe: Probe,
    course: Course,
    config: Mapping[str, object],
    blocks: Sequence[Mapping[str, Any]],
    wanted: Sequence[int],
    seconds: float,
) -> list[Given | None] | None:
    """Return an adapter's answers to some questions under each block; the model is loaded once.

    Args:
        probe: the adapter.
        course: the questions.
        config: values of deploy.yml after overrides.
        blocks: native blocks; the first is the adapter's own.
        wanted: numbers of questions.
        seconds: how long it may take.

    Returns:
        of each block, as far as the time reaches, None where it cannot be used; None in all if the block does not say
        how the adapter converts, or the model cannot be loaded there.
    """
    changes = {"blocks": list(blocks)}
    found = replayed(probe, course, config, "xpl.worker.variants", changes, wanted, seconds)
    numbers = course.with_earlier(wanted)
    return found and [None if told is None else dict(zip(numbers, told, strict=True)) for told in found]
