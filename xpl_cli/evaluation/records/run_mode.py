"""The mode of a run if it is not the usual one: in batches, with an external server, or with another instruction.

A plan holds it in the policy's configuration, under a key that adapters do not receive. Usually each episode runs
alone, and the policy is served from files whose digest is in the plan.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from xpl.contract import Announcement, Config
    from xpl_cli.evaluation.records.model import RunPlan

_KEY, _NUM_ENVS, _ANNOUNCED, _INSTRUCTION = "xpl.run", "num_envs", "announced", "instruction"

BLANK, SWAP = "blank", "swap"
INSTRUCTIONS: Final = {BLANK: "given no instruction", SWAP: "given the instruction of another episode"}
"""Replacements of the instruction, to test whether a policy follows instructions."""


@dataclass(frozen=True)
class RunMode:
    """How a run is executed.

    Attributes:
        num_envs: episodes in one batch.
        announced: announcement of an external policy server; None if the run starts its own.
        instruction: one of `INSTRUCTIONS`, if the policy does not get the task's.
    """

    num_envs: int = 1
    announced: Announcement | None = None
    instruction: str | None = None

    @property
    def description(self) -> str:
        """The unusual parts in words; "" if there are none."""
        parts = [] if self.announced is None else ["with an external policy server, whose files are unknown here"]
        parts += [f"in batches of {self.num_envs}"] if self.num_envs > 1 else []
        parts += [] if self.instruction is None else [INSTRUCTIONS[self.instruction]]
        return ", ".join(parts)

    def add_to(self, config: Config) -> Config:
        """Return the configuration of a policy with this manner in it."""
        mode: dict[str, Any] = {_NUM_ENVS: self.num_envs} if self.num_envs > 1 else {}
        if self.announced is not None:
            mode[_ANNOUNCED] = dict(self.announced)
        if self.instruction is not None:
            mode[_INSTRUCTION] = self.instruction
        return {**without_run_mode(config), **({_KEY: mode} if mode else {})}


def run_mode_of(plan: RunPlan) -> RunMode:
    """Return the mode of a plan; an invalid value counts as the usual mode."""
    mode = plan.policy.config.get(_KEY)
    mode = mode if isinstance(mode, Mapping) else {}
    count, announced = mode.get(_NUM_ENVS), mode.get(_ANNOUNCED)
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        count = 1
    value = mode.get(_INSTRUCTION)
    instruction = value if isinstance(value, str) and value in INSTRUCTIONS else None
    return RunMode(count, announced if isinstance(announced, Mapping) else None, instruction)


def without_run_mode(config: Config) -> Config:
    """Return the configuration that an adapter receives."""
    return {key: value for key, value in config.items() if key != _KEY}
