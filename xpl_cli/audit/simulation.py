"""The MuJoCo fact: an adapter served for real and driven in physics, short closed loops that are played once each."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as sdk
from xpl.action import ActionError, pack
from xpl.client import PolicyServerError
from xpl_cli import environments, evaluation
from xpl_cli.audit.model import NotApplicable, NotRun
from xpl_cli.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.audit.probe import Probe
    from xpl_cli.audit.session import Session

ENVIRONMENT = "mujoco"
STEPS = 40
"""Control steps of one loop: long enough for several chunks, short enough for every pull request."""


@dataclass
class Rollout:
    """What happened in one closed loop.

    Attributes:
        task: the task.
        seeds: one per environment.
        results: what the environment says of each episode.
        commands: per environment, the flat action of every step, (D,) each.
        seams: per environment, the steps at which a new chunk began.
        corrections: per environment, for every step the kinds of corrections that were necessary.
        problem: why the loop ended early, or None.
    """

    task: str
    seeds: tuple[int, ...]
    results: list[dict[str, Any]] = field(default_factory=list)
    commands: list[list[np.ndarray]] = field(default_factory=list)
    seams: list[list[int]] = field(default_factory=list)
    corrections: list[list[frozenset[str]]] = field(default_factory=list)
    problem: str | None = None

    @property
    def steps(self) -> int:
        """Control steps of all environments together."""
        return sum(len(commands) for commands in self.commands)

    def corrected(self, kinds: frozenset[str]) -> int:
        """Return in how many steps a correction of one of these kinds was necessary."""
        return sum(bool(kinds & found) for steps in self.corrections for found in steps)


class Simulation:
    """One adapter in physics."""

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self._rollouts: dict[tuple[str, tuple[int, ...], int | None, int | None], Rollout] = {}
        folder = environments.find(ENVIRONMENT)
        self._manifest = environments.manifest(folder)

    def record(self) -> str:
        """Return the digests of all trajectories."""
        loops = sorted(self._rollouts.items(), key=repr)
        return repr([(key, result["digest"]) for key, played in loops for result in played.results])

    def tasks(self) -> list[str]:
        """Return the tasks that the adapter's embodiment can be driven in.

        Raises:
            NotApplicable: if there are none.
        """
        robot = self.probe.embodiment
        fitting = [
            name
            for name, task in self._manifest["tasks"].items()
            if len(robot.arms) in task.get("arms", (len(robot.arms),))
        ]
        if robot.name not in self._manifest["embodiments"] or not fitting:
            offered = ", ".join(self._manifest["embodiments"])
            raise NotApplicable(f"the {ENVIRONMENT} environment has no {robot.name}; it has {offered}")
        return fitting

    def rollout(
        self, task: str, seeds: Sequence[int] = (0,), *, run: int | None = None, only: int | None = None
    ) -> Rollout:
        """Drive the adapter for `STEPS` steps; the same loop is played once per audit.

        Args:
            task: the task.
            seeds: one per environment; several are one batch.
            run: number of a run that has a server of its own, so that nothing was drawn or remembered before; None
                uses the server that all share.
            only: place of the one environment of the batch that is driven; the others stand still.

        Raises:
            NotRun: if the adapter cannot be served.
        """
        key = (task, tuple(seeds), run, only)
        if key not in self._rollouts:
            with self.probe.session() if run is None else self.probe.fresh_session() as session:
                self._rollouts[key] = self._play(session, task, tuple(seeds), only)
        return self._rollouts[key]

    def sound_rollout(
        self, task: str, seeds: Sequence[int] = (0,), *, run: int | None = None, only: int | None = None
    ) -> Rollout:
        """Return a rollout that came to its end.

        Raises:
            NotRun: if it did not; the rule `closed-loop` reports why.
        """
        played = self.rollout(task, seeds, run=run, only=only)
        if played.problem is not None:
            raise NotRun(f"the closed loop of {task} did not come to its end: {played.problem}")
        return played

    def _play(self, session: Session, task: str, seeds: tuple[int, ...], only: int | None) -> Rollout:
        env = self._make(task, len(seeds))
        played = Rollout(
            task, seeds, commands=[[] for _ in seeds], seams=[[] for _ in seeds], corrections=[[] for _ in seeds]
        )
        with contextlib.closing(env):
            env.reset(seed=list(seeds))
            session.reset()
            while played.problem is None and (running := _driven(env, only)):
                played.problem = self._chunk(session, env, played, running)
            played.results = env.results()
        return played

    def _chunk(self, session: Session, env: Any, played: Rollout, running: list[int]) -> str | None:
        """Ask once and execute the whole chunk; return what went wrong, or None."""
        refused = session.update_obs_batch(env.get_obs_batch(running))
        chunks = session.get_action_batch(running)
        for answer in (refused, chunks):
            if isinstance(answer, PolicyServerError):
                return str(answer)
        by_env = dict(zip(running, chunks, strict=False))
        for index in range(max((len(chunk) for chunk in chunks), default=0)):
            alive = env.get_running_env_idx_list()
            running = [env_idx for env_idx, chunk in by_env.items() if env_idx in alive and index < len(chunk)]
            if not running:
                return None
            if index:
                session.update_obs_batch(env.get_obs_batch(running))
            problem = self._step(env, played, {env_idx: by_env[env_idx][index] for env_idx in running}, seam=index == 0)
            if problem is not None:
                return problem
        return None if chunks else "an empty chunk"

    def _step(self, env: Any, played: Rollout, actions: dict[int, Any], *, seam: bool) -> str | None:
        probe = self.probe
        try:
            for env_idx, action in actions.items():
                played.commands[env_idx].append(pack(action, probe.embodiment, probe.action_type))
                if seam:
                    played.seams[env_idx].append(len(played.commands[env_idx]) - 1)
            reports = env.take_action_batch(list(actions.values()), list(actions))
        except ActionError as error:
            return str(error)
        for env_idx, report in zip(actions, reports, strict=True):
            kinds = frozenset(kind for arm in report["corrections"].values() for kind in arm)
            played.corrections[env_idx].append(kinds)
            if report["end_reason"] in ("non_finite_action", "unstable_physics"):
                return f"the episode ended with {report['end_reason']}"
        return None

    def _make(self, task: str, num_envs: int) -> Any:
        probe = self.probe
        request = evaluation.Request(package=probe.package, environment=ENVIRONMENT, task=task, num_envs=num_envs)
        try:
            settings = evaluation.environment_settings(
                request, {**probe.config, sdk.Deploy.ACTION_TYPE: probe.action_type}
            )
        except UserError as error:
            raise NotRun(str(error)) from None
        return environments.make(ENVIRONMENT, {**settings, "max_steps": STEPS})


def _driven(env: Any, only: int | None) -> list[int]:
    """Return the environments that still run, or of these just one."""
    return [env_idx for env_idx in env.get_running_env_idx_list() if only in (None, env_idx)]


def largest_jumps(played: Rollout, columns: np.ndarray) -> tuple[float, float]:
    """Return the largest change of the chosen columns between consecutive commands: at chunk seams, and inside chunks.

    Args:
        played: the loop.
        columns: indices of flat action values to look at.
    """
    seam, inside = 0.0, 0.0
    for commands, seams in zip(played.commands, played.seams, strict=True):
        for step in range(1, len(commands)):
            change = float(np.abs(commands[step][columns] - commands[step - 1][columns]).max())
            if step in seams:
                seam = max(seam, change)
            else:
                inside = max(inside, change)
    return seam, inside


def arm_columns(probe: Probe) -> np.ndarray:
    """Return the flat action columns of joint angles or positions: what must not jump. Grippers may."""
    columns: list[int] = []
    start = 0
    for key, dim in probe.embodiment.dims(probe.action_type).items():
        if not key.endswith(sdk.State.EE_JOINT_STATE):
            width = sdk.POSITION_DIM if key.endswith(sdk.State.EE_POSE) else dim
            columns += range(start, start + width)
        start += dim
    return np.array(columns)
