"""The MuJoCo fact: an adapter served for real and driven in physics, short closed loops that are played once each."""

from __future__ import annotations

import contextlib
from functools import cached_property
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl.embodiment import get_embodiment
from xpl_cli.audit.physics.loop import Driver, Result, Rollout, Show
from xpl_cli.audit.physics.own_loop import Stage
from xpl_cli.audit.rules.figures import ENVIRONMENT, Course
from xpl_cli.audit.rules.model import NotApplicable, NotRun
from xpl_cli.basics.errors import NotFoundError, UserError
from xpl_cli.environments import check
from xpl_cli.evaluation.runs.settings import environment_settings
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl.contract import ObservationDict
    from xpl.environment import TaskEnv
    from xpl_cli.audit.physics.loop import Watch
    from xpl_cli.audit.physics.mirrors import World
    from xpl_cli.audit.rules.figures import Figure
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.audit.served.session import Session

STEPS, CHUNKS, MOST_STEPS = 40, 4, 240
"""Control steps of one loop, and chunks, at least; and how many steps at most: short enough for every pull request."""
_FIRST_SEED = 0
_AT_ONCE = 4
"""Whole episodes that are played in one batch."""


class Simulation:
    """One adapter in physics.

    Args:
        probe: the adapter.

    Attributes:
        probe: the adapter.
        frequency: control rate of the environment, Hz.
        figures: what was measured over whole episodes.
    """

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.figures: list[Figure] = []
        self._rollouts: dict[tuple[object, ...], Rollout] = {}
        self._folder = environments.find(ENVIRONMENT)
        self._manifest = environments.manifest(self._folder)
        self.frequency = self._manifest.control_frequency

    def record(self) -> str:
        """Return the digests of all trajectories."""
        return repr(sorted((repr(key), played.digests) for key, played in self._rollouts.items()))

    # -- what is driven ------------------------------------------------------------------------------------------------

    @cached_property
    def courses(self) -> tuple[Course, ...]:
        """What is driven: every robot and action type that the manifest declares and the environment offers.

        The first pair, the configured one where it is offered, is driven in several tasks: those that were asked for,
        or that the manifest claims to solve, or else the one that deploy.yml names and one of each capability
        dimension. Every other pair is driven in one.

        Raises:
            NotApplicable: if nothing can be.
        """
        if unseen := self._unseen():
            raise NotApplicable(f"the {ENVIRONMENT} environment does not observe with {', '.join(unseen)}")
        found: list[Course] = []
        for robot, action_type in self.probe.combinations():
            if robot in self._manifest.embodiments and action_type in self._manifest.action_types:
                tasks = self._tasks(robot)[: 1 if found else None]
                found += [Course(task, robot, action_type) for task in tasks]
        if not found:
            robots = ", ".join(dict.fromkeys(robot for robot, _ in self.probe.combinations()))
            offered = ", ".join(self._manifest.embodiments)
            why = f"for {robots} {ENVIRONMENT} has none of the tasks" if self._offers_one() else f"no {robots}"
            raise NotApplicable(f"the {ENVIRONMENT} environment has {why}; it has {offered}")
        return tuple(found)

    @property
    def first(self) -> Course:
        """The course in which experiments are made that need no more than one."""
        return self.courses[0]

    def _tasks(self, robot: str) -> list[str]:
        """Return the tasks in which a robot is driven, the most telling first."""
        offered = {name: task for name, task in self._manifest.tasks.items() if check.unsupported(task, robot) is None}
        claimed = self.probe.package.manifest.claims
        chosen = self.probe.options.tasks or [claim.task for claim in claimed if claim.environment == ENVIRONMENT]
        if chosen:
            return [name for name in dict.fromkeys(chosen) if name in offered]
        configured = str(self.probe.config.get(sdk.Deploy.TASK_NAME))
        by_dimension: dict[str, str] = {}
        for name, task in offered.items():
            by_dimension.setdefault(task.dimension or name, name)
        return list(dict.fromkeys([*([configured] if configured in offered else []), *by_dimension.values()]))

    def _unseen(self) -> list[str]:
        """Return needed cameras that the standard leaves to environments: this one has them for films only."""
        needed = self.probe.package.manifest.required
        return [name for name in sdk.OPTIONAL_CAMERAS if f"{sdk.Obs.VISION}.{name}" in needed]

    def _offers_one(self) -> bool:
        return any(robot in self._manifest.embodiments for robot, _ in self.probe.combinations())

    # -- loops ---------------------------------------------------------------------------------------------------------

    def rollouts(self) -> Iterator[Rollout]:
        """Yield one loop of every course, whether it came to its end or not."""
        for course in self.courses:
            yield self.rollout(course)

    def sound_rollouts(self) -> Iterator[Rollout]:
        """Yield one loop of every course.

        Raises:
            NotRun: if one did not come to its end; the rule `closed-loop` reports why.
        """
        for course in self.courses:
            yield self.sound_rollout(course)

    def rollout(self, course: Course, seeds: Sequence[int] = (_FIRST_SEED,), *, again: int = 0) -> Rollout:
        """Drive the adapter for some chunks, by the server that all share; the same loop is played once per audit.

        Raises:
            NotRun: if the adapter cannot be served.
        """
        key = ("shared", course, tuple(seeds), again)
        if key not in self._rollouts:
            with self.probe.served_as(course.embodiment, course.action_type) as session:
                self._rollouts[key] = self._play(session, course, seeds, film=not again)
        return self._rollouts[key]

    def sound_rollout(self, course: Course, seeds: Sequence[int] = (_FIRST_SEED,), *, again: int = 0) -> Rollout:
        """Return a rollout that came to its end.

        Raises:
            NotRun: if it did not; the rule `closed-loop` reports why.
        """
        return _sound(self.rollout(course, seeds, again=again))

    def mirrored(self, course: Course, world: World) -> Rollout:
        """Drive the adapter for some chunks in an environment in which one thing is exchanged.

        Raises:
            NotRun: if the loop did not come to its end.
        """
        key = ("mirrored", course, (_FIRST_SEED,), world)
        if key not in self._rollouts:
            with self.probe.served_as(course.embodiment, course.action_type) as session:
                self._rollouts[key] = self._play(session, course, (_FIRST_SEED,), world=world)
        return _sound(self._rollouts[key])

    @property
    def cameras(self) -> list[str]:
        """The cameras that the policy reads and the environment has."""
        read = self.probe.package.manifest.read
        names = [name.partition(".")[2] for name in read if name.startswith(sdk.Obs.VISION)]
        return [name for name in names if name in self._manifest.cameras]

    def afresh(self, seeds: Sequence[int], *, run: int) -> Rollout:
        """Drive the first course by a server of its own, so that nothing was drawn or remembered before.

        Raises:
            NotRun: if the loop did not come to its end.
        """
        key = ("fresh", self.first, tuple(seeds), run)
        if key not in self._rollouts:
            with self._fresh() as session:
                self._rollouts[key] = self._play(session, self.first, seeds)
        return _sound(self._rollouts[key])

    def together(self, seeds: Sequence[int]) -> Rollout:
        """Drive the first course in one batch, for a comparison with `alone`.

        Raises:
            NotRun: if the loop did not come to its end.
        """
        return self._steadily(seeds)

    def alone(self, seeds: Sequence[int], place: int) -> Rollout:
        """Ask about one environment of a batch by itself; it moves as it did there, so that it shows the same.

        Answers to one's own commands would drift: batched kernels round differently, and each step adds to it.

        Args:
            seeds: of the batch.
            place: of the environment; the others stand still.

        Raises:
            NotRun: if a loop did not come to its end.
        """
        return self._steadily(seeds, only=place, follows=self.together(seeds))

    def beside_itself(self, seeds: Sequence[int], place: int) -> Rollout:
        """Ask about one environment of a batch as `alone` does, in a batch as large, whose others show the same as it.

        Args:
            seeds: of the batch.
            place: of the environment; the others stand still.

        Raises:
            NotRun: if a loop did not come to its end.
        """
        return self._steadily(seeds, only=place, follows=self.together(seeds), copied=True)

    def _steadily(
        self, seeds: Sequence[int], only: int | None = None, follows: Rollout | None = None, *, copied: bool = False
    ) -> Rollout:
        key = ("copied" if copied else "steady", self.first, tuple(seeds), only)
        if key not in self._rollouts:
            with self.steady() as session:
                self._rollouts[key] = self._play(session, self.first, seeds, only=only, follows=follows, copied=copied)
        return _sound(self._rollouts[key])

    @contextlib.contextmanager
    def steady(self) -> Iterator[Session]:
        """Connect for an experiment whose answers are compared with those of another.

        Where the policy draws other random numbers in every episode, each experiment gets a server of its own.

        Raises:
            NotApplicable: if the policy is declared not deterministic.
        """
        self.probe.require_deterministic()
        course = self.first
        with self.probe.served_as(course.embodiment, course.action_type) if self._repeats else self._fresh() as session:
            yield session

    @cached_property
    def _repeats(self) -> bool:
        """Whether one server drives the first course in its second episode as in its first."""
        return self.sound_rollout(self.first).digests == self.sound_rollout(self.first, again=1).digests

    def _fresh(self) -> contextlib.AbstractContextManager[Session]:
        course = self.first
        return self.probe.fresh_session(
            **{sdk.Deploy.ENV_CFG_TYPE: course.embodiment, sdk.Deploy.ACTION_TYPE: course.action_type}
        )

    def show(self, questions: int) -> Show:
        """Return what the policy is shown in the first course, up to a question.

        Args:
            questions: how many are asked, where the course has as many.

        Raises:
            NotRun: if the loop did not come to its end.
        """
        shown: list[ObservationDict] = []
        with self.steady() as session:
            played = self._play(session, self.first, (_FIRST_SEED,), shown=shown)
        asked = tuple(query.step for query in _sound(played).queries[0][:questions])
        return Show(tuple(shown[: asked[-1] + 1]), asked)

    @contextlib.contextmanager
    def staged(self, count: int) -> Iterator[tuple[Stage, Session]]:
        """Give the first course to a loop of somebody else's, with episodes that end in the middle of a chunk.

        Args:
            count: environments; each ends a chunk later than the one before.
        """
        course, chunk = self.first, self._chunk
        with contextlib.closing(self._make(course, count, None)) as env:
            env.reset(seed=list(range(count)))
            stage = Stage(env, [(place + 1) * chunk + chunk // 2 + 1 for place in range(count)])
            with self.probe.served_as(course.embodiment, course.action_type) as session:
                yield stage, session

    # -- whole episodes ------------------------------------------------------------------------------------------------

    def seeds(self, course: Course, count: int) -> list[int]:
        """Return the first of the frozen evaluation seeds of a course's task.

        Raises:
            NotRun: if it has none.
        """
        try:
            return check.seeds(self._folder, course.task, course.setting or self._manifest.settings[0])[:count]
        except NotFoundError as error:
            raise NotRun(str(error)) from None

    def episodes(self, course: Course, seeds: Sequence[int], world: World | None = None) -> list[Result]:
        """Play whole episodes, some at a time in one batch, and return their results.

        Args:
            course: what is driven.
            seeds: one per episode.
            world: how the environment differs from the real one.

        Raises:
            NotRun: if one breaks off.
        """
        results: list[Result] = []
        with self.probe.served_as(course.embodiment, course.action_type) as session:
            for start in range(0, len(seeds), _AT_ONCE):
                batch = tuple(seeds[start : start + _AT_ONCE])
                key = ("whole", course, batch, world)
                if key not in self._rollouts:
                    self._rollouts[key] = self._play(session, course, batch, whole=True, world=world, film=not world)
                results += _sound(self._rollouts[key]).results
        return results

    # -- inside --------------------------------------------------------------------------------------------------------

    def _play(  # noqa: PLR0913 - by keyword, how one episode differs from another
        self,
        session: Session,
        course: Course,
        seeds: Sequence[int],
        *,
        only: int | None = None,
        whole: bool = False,
        world: World | None = None,
        film: bool = False,
        shown: list[ObservationDict] | None = None,
        follows: Rollout | None = None,
        copied: bool = False,
    ) -> Rollout:
        played = Rollout(course, get_embodiment(course.embodiment), tuple(seeds))
        made = self._make(course, len(seeds), None if whole else self._steps)
        with contextlib.closing(made):
            made.reset(seed=list(seeds))
            env = made if world is None else world.around(made, played.robot)
            with self._filmed(course, seeds, wanted=film) as watch:
                Driver(session, env, played, only, watch, shown, follows, copied).drive()
        return played

    @property
    def _chunk(self) -> int:
        """Action steps of a chunk, as far as the manifest says."""
        return self.probe.package.manifest.temporal.chunk or 1

    @property
    def _steps(self) -> int:
        return min(MOST_STEPS, max(STEPS, CHUNKS * self._chunk))

    def _make(self, course: Course, num_envs: int, max_steps: int | None) -> TaskEnv:
        probe = self.probe
        pair = {sdk.Deploy.ENV_CFG_TYPE: course.embodiment, sdk.Deploy.ACTION_TYPE: course.action_type}
        try:
            settings = environment_settings(
                probe.package,
                ENVIRONMENT,
                {**probe.config, **pair},
                task=course.task,
                setting=course.setting,
                num_envs=num_envs,
            )
        except UserError as error:
            raise NotRun(str(error)) from None
        return environments.make(ENVIRONMENT, {**settings.as_config(), "max_steps": max_steps})

    @contextlib.contextmanager
    def _filmed(self, course: Course, seeds: Sequence[int], *, wanted: bool) -> Iterator[Watch | None]:
        folder = self.probe.options.video
        if folder is None or not wanted:
            yield None
            return
        from xpl_cli.audit.physics.film import films

        with films(folder, self.probe.package.name, course, seeds, self.frequency) as watch:
            yield watch


def check_tasks(names: Sequence[str]) -> None:
    """Check names of tasks before anything is started.

    Raises:
        NotFoundError: if the environment has no such task.
    """
    known = environments.manifest(environments.find(ENVIRONMENT)).tasks
    for name in names:
        if name not in known:
            raise NotFoundError(f"{ENVIRONMENT} has no task {name!r}; it has {', '.join(known)}")


def _sound(played: Rollout) -> Rollout:
    if played.problem is not None:
        raise NotRun(f"the closed loop of {played.course} did not come to its end: {played.problem}")
    return played
