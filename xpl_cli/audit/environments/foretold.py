"""What the trials of an audit would do to a robot, found out without one.

Until somebody says that a robot may move (`--move`), nothing of an environment is made that does not say that it is a
simulation. The same rules play in its stead a stand-in of kinematics, in this process, and what they ask of it is
counted.
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
from xpl_cli.audit.environments.stage import OPENING, SHIFT, SWING, Offer, Play, Stage
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from xpl import contract
    from xpl.contract import Action, State
    from xpl_cli.audit.rules.options import Options
    from xpl_cli.audit.rules.registry import Entry

_OUTSIDE = "env-limits"
"""The rule that commands what no robot should do, to see whether the environment keeps it from it."""
_KNOWN = frozenset(
    ("task", "embodiment", sdk.Deploy.ACTION_TYPE, "num_envs", "max_steps", "cameras", sdk.Obs.PRIVILEGED)
)


@dataclass
class Motions:
    """What trials ask of an environment.

    Attributes:
        robots: embodiments that are made.
        tasks: tasks that are played.
        made: environments that are made.
        episodes: episodes that begin; each puts the robot back to its start.
        steps: control steps that are commanded.
        seconds: how long these take at the environment's own rate, s.
    """

    robots: set[str] = field(default_factory=set)
    tasks: set[str] = field(default_factory=set)
    made: int = 0
    episodes: int = 0
    steps: int = 0
    seconds: float = 0.0


def withheld(path: Path, entries: Sequence[Entry], options: Options) -> str | None:
    """Return why rules may not play an environment, with what they would do to it; None where they may.

    Args:
        path: the environment package.
        entries: the rules that were chosen.
        options: how it is audited.
    """
    if options.move or not environments.manifest(path).is_real:
        return None
    stage = _Foreseen(path, options)
    for entry in entries:
        with contextlib.suppress(Exception):  # what a rule finds of the stand-in, or stumbles over, says nothing
            for _ in entry.load().check(stage):
                pass
    seen = stage.motions
    if not seen.made:
        return None  # the rules have nothing to play, and say why
    beyond = any(entry.slug == _OUTSIDE for entry in entries)
    robots, tasks = (", ".join(sorted(names)) for names in (seen.robots, seen.tasks))
    wrong = (
        "; and NaN, to see it refused, and joints 1 rad beyond their limits where the client says that it keeps them "
        "(`guarded`)"
    )
    return (
        f"env.yml does not say `real_time: false`, so a robot may stand behind it, and nothing was moved. With --move "
        f"the audit would make {robots} ready {seen.made} times, begin {seen.episodes} episodes of {tasks} and command "
        f"{seen.steps} control steps ({seen.seconds:.0f} s): swings of {SWING:g} rad or {1000 * SHIFT:g} mm about the "
        f"start pose, grippers by {OPENING:.0%} of their range{wrong if beyond else ''}. Say `real_time: false` in "
        f"env.yml if it is a simulation that waits for the policy"
    )


class _Foreseen(Stage):
    """A stage on which the stand-in plays."""

    def __init__(self, path: Path, options: Options) -> None:
        super().__init__(path, options)
        self.motions = Motions()

    @contextlib.contextmanager
    def play(self, offer: Offer, *, fresh: bool = False, **config: object) -> Iterator[Play]:  # noqa: ARG002 - as there
        """Make the stand-in, which every offer suits."""
        self.motions.made += 1
        asked = {key: value for key, value in config.items() if key in _KNOWN}
        asked |= {"task": offer.task, "embodiment": offer.embodiment, sdk.Deploy.ACTION_TYPE: offer.action_type}
        try:
            env = Environment(_StandIn, self.manifest, {"cameras": False, **asked})
        except ValueError as error:
            raise EnvRaisedError(type(error).__name__, str(error)) from None
        self.motions.robots.add(offer.embodiment)
        self.motions.tasks.add(offer.task)
        yield _Counted(env, self.motions, 1.0 / self.manifest.frequency(offer.task))


class _Counted(Play):
    """The stand-in's operations, counted."""

    guarded = True

    def __init__(self, env: Environment, motions: Motions, period: float) -> None:
        self._env, self._motions, self._period = env, motions, period

    def calls(self, asked: Sequence[Sequence[Any]]) -> list[Any]:
        return [self._called(*each) for each in asked]

    def _called(self, method: str, arguments: Sequence[Any]) -> Any:
        if method == sdk.Method.RESET:
            self._motions.episodes += len(arguments[0])
        if method == "take_action_batch":
            self._motions.steps += len(arguments[1])
            self._motions.seconds += self._period
        try:
            return getattr(self._env, method)(*arguments)
        except Exception as error:  # noqa: BLE001 - as the process of a real one answers it
            raise EnvRaisedError(type(error).__name__, str(error)) from None


class _StandIn(Episode):
    """Arms that are where they were told to be, without a scene."""

    def reset(self, seed: int) -> None:
        """Begin at home; the seed shows in the truth alone."""
        self._seed = seed
        self._state: contract.ObservationDict = {}
        for arm in self.setup.embodiment.arms:
            middle = np.zeros(arm.dof) if arm.lower is None or arm.upper is None else (arm.lower + arm.upper) / 2
            self._state[arm.prefix + sdk.State.ARM_JOINT_STATE] = middle
            self._state[arm.prefix + sdk.State.EE_JOINT_STATE] = np.full(arm.ee_dim, sdk.GRIPPER_OPEN)
            self._state[arm.prefix + sdk.State.EE_POSE] = pose([0.3, 0.0, 0.3], [1.0, 0.0, 0.0, 0.0])

    def state(self) -> State:
        """Return what was commanded last."""
        return self._state

    def step(self, action: Action) -> None:
        """Take the targets over."""
        self._state = {**self._state, **action}

    def score(self) -> float:
        """Nothing is ever done."""
        return 0.0

    def vision(self) -> Mapping[str, contract.Entry]:
        """Return pictures that show nothing, of the size that env.yml declares."""
        sizes = {
            name: ((told or {}).get("height") or 8, (told or {}).get("width") or 8)
            for name, told in self.setup.manifest.cameras.items()
        }
        return {
            name: {sdk.Camera.COLOR: np.zeros((*size, sdk.COLOR_CHANNELS), np.uint8)} for name, size in sizes.items()
        }

    def truth(self) -> contract.Entry:
        """Return the seed, so that seeds differ."""
        return {sdk.Deploy.SEED: self._seed}
