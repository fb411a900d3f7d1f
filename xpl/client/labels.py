"""Labels of an evaluation in every frame, and timing keys that are passed as arguments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


class Unset:
    """Default of an argument whose None has a meaning."""

    def __repr__(self) -> str:
        return "as in config"


UNSET = Unset()


@dataclass
class Labels:
    """Labels of every frame; they may change between requests. The codec checks their types.

    Attributes:
        evaluation_id: name of the evaluation.
        trial_id, action_case_id: names of the trial and of its case, None where the benchmark has none.
        repeat_index: number of earlier trials of the case, None where the benchmark does not count.
    """

    evaluation_id: str
    trial_id: str | None = None
    action_case_id: str | None = None
    repeat_index: int | None = None


def timing_overrides(limits: dict[str, Any], pings: dict[str, Any]) -> dict[str, Any]:
    """Return the timing keys that were passed as arguments.

    Args:
        limits: by their keys of deploy.yml; None means the value of the configuration.
        pings: the same for pings; None turns them off, `UNSET` means the value of the configuration.
    """
    return {
        **{name: value for name, value in limits.items() if value is not None},
        **{name: value for name, value in pings.items() if not isinstance(value, Unset)},
    }
