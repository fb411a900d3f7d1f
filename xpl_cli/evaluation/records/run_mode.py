"""In which manner a run is played, where that is not the usual one: in batches, by a foreign server, told other words.

A plan says so among the policy's configuration, under a key that no adapter is given. Usually each episode is played
alone, and the policy is served from files whose digest the plan has.
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
INSTRUCTIONS: Final = {BLANK: "told nothing to do", SWAP: "told what another episode is about"}
"""What a policy may be told instead of the instruction, to see whether it heeds it."""


@dataclass(frozen=True)
class RunMode:
    """How a run is played.

    Attributes:
        num_envs: episodes at once, in one batch.
        announced: what the server said of its policy that somebody else runs; None where the run starts its own.
        instruction: one of `INSTRUCTIONS`, where the policy is not told what it is to do.
    """

    num_envs: int = 1
    announced: Announcement | None = None
    instruction: str | None = None

    @property
    def description(self) -> str:
        """What is unusual about it, in words; "" for nothing."""
        parts = (
            [] if self.announced is None else ["by a policy server that somebody else runs, from files unknown here"]
        )
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
    """Return the manner of a plan; whatever is no such thing in it is taken for the usual one."""
    mode = plan.policy.config.get(_KEY)
    mode = mode if isinstance(mode, Mapping) else {}
    count, announced = mode.get(_NUM_ENVS), mode.get(_ANNOUNCED)
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        count = 1
    value = mode.get(_INSTRUCTION)
    instruction = value if isinstance(value, str) and value in INSTRUCTIONS else None
    return RunMode(count, announced if isinstance(announced, Mapping) else None, instruction)


def without_run_mode(config: Config) -> Config:
    """Return the configuration that an adapter is given."""
    return {key: value for key, value in config.items() if key != _KEY}
