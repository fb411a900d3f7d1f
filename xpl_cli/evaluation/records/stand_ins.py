"""Settings in which something stands in for a part of a benchmark: what they tell is never the benchmark's number.

An environment names such a setting `stand_in...`. The name is in every plan, line and row of a run, so that nobody can
take one for the benchmark, whatever else is lost on the way.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from xpl_cli.basics.errors import ExitCode, UserError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from xpl_cli.evaluation.records.records import Run

_PREFIX: Final = "stand_in"


def is_one(setting: str) -> bool:
    """Tell whether something stands in for a part of the benchmark in a setting."""
    return setting.startswith(_PREFIX)


def sentence(environment: str, settings: Iterable[str]) -> str | None:
    """Return what is to be said beside any figure of some settings; None if none of them is one."""
    mocks = [setting for setting in dict.fromkeys(settings) if is_one(setting)]
    if not mocks:
        return None
    return (
        f"In {', '.join(mocks)} something stands in for a part of {environment}: these episodes show whether code fits "
        f"together, and are none of {environment}'s numbers."
    )


def refuse(run: Run, what: str) -> None:
    """Raise where something stood in for a part of the benchmark in any episode of a run.

    Args:
        run: of which a figure would go on as the benchmark's.
        what: would be done with it, as a participle.

    Raises:
        UserError: it did.
    """
    message = sentence(run.plan.environment.name, (cell.setting for cell in run.plan.cells))
    if message is not None:
        raise UserError(f"{run.folder} is not {what}. {message}", code=ExitCode.NOT_RUN)
