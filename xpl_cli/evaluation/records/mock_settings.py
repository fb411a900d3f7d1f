"""Settings that replace a part of a benchmark by a mock: their results are never the benchmark's.

An environment names such a setting `stand_in...`. The name is in every plan, line and row of a run, so that it cannot
be confused with the benchmark.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from xpl_cli.basics.errors import ExitCode, UserError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from xpl_cli.evaluation.records.records import Run

_PREFIX: Final = "stand_in"


def is_mock(setting: str) -> bool:
    """Return whether a setting replaces a part of the benchmark by a mock."""
    return setting.startswith(_PREFIX)


def remark(environment: str, settings: Iterable[str]) -> str | None:
    """Return the remark that belongs to every figure of mock settings; None if there are none."""
    mocks = [setting for setting in dict.fromkeys(settings) if is_mock(setting)]
    if not mocks:
        return None
    return (
        f"{', '.join(mocks)} replaces a part of {environment} by a mock: these episodes test whether code works "
        f"together, and are no results of {environment}."
    )


def refuse(run: Run, what: str) -> None:
    """Raise if any episode of a run used a mock of a part of the benchmark.

    Args:
        run: whose figures would count as the benchmark's.
        what: the refused use, as a participle.

    Raises:
        UserError: it did.
    """
    message = remark(run.plan.environment.name, (cell.setting for cell in run.plan.cells))
    if message is not None:
        raise UserError(f"{run.folder} is not {what}. {message}", code=ExitCode.NOT_RUN)
