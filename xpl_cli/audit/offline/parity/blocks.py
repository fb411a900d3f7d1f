"""An adapter's answers under other words of its native block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.audit.offline import inprocess
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.isolation import errand

if TYPE_CHECKING:
    from xpl_cli.audit.offline.parity.course import Course
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.native.pairs import Chunk

_MORE_S = 30.0
"""What loading the model may take besides."""

Given = dict[int, "Chunk"]
"""By number of a question its answer."""


def answers(  # noqa: PLR0913, PLR0917 - who, what, how, and for how long
    probe: Probe,
    course: Course,
    config: Mapping[str, Any],
    blocks: Sequence[Mapping[str, Any]],
    wanted: Sequence[int],
    seconds: float,
) -> list[Given | None] | None:
    """Return an adapter's answers to some questions under each block; the model is loaded once.

    Args:
        probe: the adapter.
        course: the questions.
        config: keys of deploy.yml.
        blocks: native blocks; the first is the adapter's own.
        wanted: numbers of questions.
        seconds: how long it may take.

    Returns:
        of each block, as far as the time reaches, None where it cannot be used; None in all if the block does not say
        how the adapter converts, or the model cannot be loaded there.
    """
    package = probe.package
    order = {
        **inprocess.loading(probe),
        "config": package.config({**probe.options.overrides, **config}),
        "blocks": list(blocks),
        "calls": course.told(course.calls(wanted)),
        "seconds": seconds,
    }
    done = errand.run("xpl.worker.variants", order, inprocess.place(probe, seconds + _MORE_S))
    try:
        found = inprocess.loaded(done)
    except NotRun:
        return None
    if done.answers[0][sdk.Payload.RESULT] is not None:
        return None
    numbers = course.with_earlier(wanted)
    return [
        None if "error" in answer else dict(zip(numbers, answer[sdk.Payload.RESULT], strict=True)) for answer in found
    ]
