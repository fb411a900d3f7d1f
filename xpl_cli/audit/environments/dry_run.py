"""Dry run of the rules for environments: counts the motions that they would command a robot.

Without `--move`, no environment runs that does not declare itself a simulation. The same rules run with a fake
environment in this process instead, and its operations are counted.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as sdk
from xpl.environment import Environment, Episode
from xpl.poses import pose
from xpl.simulator.process import EnvRaisedError
from xpl_cli.audit.environments.env_probe import OPENING, SHIFT, SWING, EnvProbe, Offer, RunningEnv
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from xpl import contract
    from xpl.contract import Action, State
    from xpl_cli.audit.rules.options import AuditOptions
    from xpl_cli.audit.rules.registry import RuleEntry

_LIMITS_RULE = "env-limits"
"""The rule that commands motions beyond a robot's limits."""
_SUPPORTED_KEYS = frozenset(
    ("task", "embodiment", sdk.Deploy.ACTION_TYPE, "num_envs", "max_steps", "cameras", sdk.Obs.PRIVILEGED)
)


@dataclass
class DryRunCounts:
    """Numbers of operations in a dry run.

    Attributes:
        robots: embodiments.
        tasks: tasks.
        made: number of environments that are created.
        episodes: number of episodes; each moves the robot to its start pose.
        steps: number of control steps.
        seconds: their duration at the environment's control frequency, s.
    """

    robots: set[str] = field(default_factory=set)
    tasks: set[str] = field(default_factory=set)
    made: int = 0
    episodes: int = 0
    steps: int = 0
    seconds: float = 0.0


def dry_run_report(path: Path, entries: Sequence[RuleEntry], options: AuditOptions) -> str | None:
    """Return why rules may not run an environment, with the motions that they would command; None if they may.

    Args:
        path: the environment package.
        entries: the selected rules.
        options: options of the audit.
    """
    if options.move or not environments.manifest(path).is_real:
        return None
    env_probe = _DryRunProbe(path, options)
    for entry in entries:
        with contextlib.suppress(Exception):  # results of rules on the fake environment mean nothing
            for _ in entry.load().check(env_probe):
                pass
    counts = env_probe.motions
    if not counts.made:
        return None  # the rules run nothing, and report why
    beyond = any(entry.slug == _LIMITS_RULE for entry in entries)
    robots, tasks = (", ".join(sorted(names)) for names in (counts.robots, counts.tasks))
    wrong = (
        "; and NaN, which it has to refuse, and joints 1 rad beyond their limits if the client declares that it clamps "
        "them (`guarded`)"
    )
    return (
        f"env.yml does not declare `real_time: false`, so it may be a robot, and nothing was moved. With --move the "
        f"audit would create {robots} {counts.made} times, run {counts.episodes} episodes of {tasks} and command "
        f"{counts.steps} control steps ({counts.seconds:.0f} s): swings of {SWING:g} rad or {1000 * SHIFT:g} mm about "
        f"the start pose, grippers by {OPENING:.0%} of their range{wrong if beyond else ''}. Declare `real_time: "
        f"false` in env.yml if it is a simulation that waits for the policy"
    )


class _DryRunProbe(EnvProbe):
    """An `EnvProbe` that creates fake environments."""

    def __init__(self, path: Path, options: AuditOptions) -> None:
        super().__init__(path, options)
        self.motions = DryRunCounts()

    @contextlib.contextmanager
    def make_env(self, offer: Offer, *, fresh: bool = False, **config: object) -> Iterator[RunningEnv]:  # noqa: ARG002 - as there
        """Create the fake environment, which supports every offer."""
        self.motions.made += 1
        supported = {key: value for key, value in config.items() if key in _SUPPORTED_KEYS}
        supported |= {"task": offer.task, "embodiment": offer.embodiment, sdk.Deploy.ACTION_TYPE: offer.action_type}
        try:
            env = Environment(_FakeEpisode, self.manifest, {"cameras": False, **supported})
        except ValueError as error:
            raise EnvRaisedError(type(error).__name__, str(error)) from None
        self.motions.robots.add(offer.embodiment)
        self.motions.tasks.add(offer.task)
        yield _CountingEnv(env, self.motions, 1.0 / self.manifest.frequency(offer.task))


class _CountingEnv(RunningEnv):
    """The fake environment; counts its operations."""

    guarded = True

    def __init__(self, env: Environment, motions: DryRunCounts, period: float) -> None:
        self._env, self._motions, self._period = env, motions, period

    def calls(self, asked: Sequence[Sequence[Any]]) -> list[Any]:
        return [self._count_and_call(*each) for each in asked]

    def _count_and_call(self, method: str, arguments: Sequence[Any]) -> Any:
        if method == sdk.Method.RESET:
            self._motions.episodes += len(arguments[0])
        if method == "take_action_batch":
            self._motions.steps += len(arguments[1])
            self._motions.seconds += self._period
        try:
            return getattr(self._env, method)(*arguments)
        except Exception as error:  # noqa: BLE001 - as the process of a real one answers it
            raise EnvRaisedError(type(error).__name__, str(error)) from None


class _FakeEpisode(Episode):
    """Arms that are at their commanded pose, without a scene."""

    def reset(self, seed: int) -> None:
        """Start at the middle of the joint ranges; the seed appears only in the ground truth."""
        self._seed = seed
        self._state: contract.ObservationDict = {}
        for arm in self.setup.embodiment.arms:
            middle = np.zeros(arm.dof) if arm.lower is None or arm.upper is None else (arm.lower + arm.upper) / 2
            self._state[arm.prefix + sdk.State.ARM_JOINT_STATE] = middle
            self._state[arm.prefix + sdk.State.EE_JOINT_STATE] = np.full(arm.ee_dim, sdk.GRIPPER_OPEN)
            self._state[arm.prefix + sdk.State.EE_POSE] = pose([0.3, 0.0, 0.3], [1.0, 0.0, 0.0, 0.0])

    def state(self) -> State:
        """Return the last command."""
        return self._state

    def step(self, action: Action) -> None:
        """Set the state to the targets."""
        self._state = {**self._state, **action}

    def score(self) -> float:
        """Return 0."""
        return 0.0

    def vision(self) -> Mapping[str, contract.Entry]:
        """Return black images of the size that env.yml declares."""
        sizes = {
            name: ((declared or {}).get("height") or 8, (declared or {}).get("width") or 8)
            for name, declared in self.setup.manifest.cameras.items()
        }
        return {
            name: {sdk.Camera.COLOR: np.zeros((*size, sdk.COLOR_CHANNELS), np.uint8)} for name, size in sizes.items()
        }

    def truth(self) -> contract.Entry:
        """Return the seed, so that seeds differ."""
        return {sdk.Deploy.SEED: self._seed}
