"""Asks an adapter again, in a process of its interpreter, under changes that an errand of the worker makes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from xpl_cli.audit.offline import inprocess
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.isolation import errand

if TYPE_CHECKING:
    from xpl_cli.audit.offline.parity.course import Course
    from xpl_cli.audit.served.probe import Probe

_MORE_S = 30.0
"""What loading the model may take besides."""


def replayed(  # noqa: PLR0913, PLR0917 - who, what, how, and for how long
    probe: Probe,
    course: Course,
    config: Mapping[str, object],
    module: str,
    changes: Mapping[str, Sequence[Any]],
    wanted: Sequence[int],
    seconds: float,
) -> list[Any] | None:
    """Return what an errand says of each change; the model is loaded once.

    Args:
        probe: the adapter.
        course: the questions.
        config: values of deploy.yml after overrides.
        module: the errand's, which plays the calls under each change.
        changes: its list of changes, under the key that the errand knows.
        wanted: numbers of questions.
        seconds: how long it may take.

    Returns:
        the results, as far as the time reaches, None for a change that has no meaning here; None in all if the errand
        has no use for the adapter, or the model cannot be loaded there.
    """
    order = {
        **inprocess.loading(probe),
        "config": config,
        **changes,
        "calls": course.told(course.calls(wanted)),
        "seconds": seconds,
    }
    done = errand.run(module, order, inprocess.place(probe, seconds + _MORE_S))
    try:
        found = inprocess.loaded(done)
    except NotRun:
        return None
    if done.answers[0].result is not None:
        return None
    return [answer.result for answer in found]
