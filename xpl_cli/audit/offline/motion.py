"""A short episode for every robot and action type that an adapter declares; actions are executed exactly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as sdk
from xpl.client import PolicyServerError
from xpl.embodiment import Embodiment, get_embodiment
from xpl_cli.audit.rules.model import NotApplicable
from xpl_cli.audit.served.compare import structure_problem
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from xpl.contract import ObservationDict
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.audit.served.recorded_client import RecordedClient

_STEPS = 3
_BATCH = (0, 1)
_MARGIN = 0.02
"""Share of a joint's range that it has left where it is near a limit."""


@dataclass(frozen=True)
class MotionAnswer:
    """A chunk, with what it answers.

    Attributes:
        obs: the newest observation of the environment.
        step: its control step.
        chunk: what the adapter answered.
        batched: whether it is part of a batch.
    """

    obs: ObservationDict
    step: int
    chunk: Any
    batched: bool

    @property
    def where(self) -> str:
        """Which answer it is, in words."""
        together = " of a batch" if self.batched else ""
        return f"environment {self.obs[sdk.Obs.ENV_IDX]}{together}, step {self.step}"


@dataclass(frozen=True)
class MotionEpisode:
    """The answers of an adapter for one robot and action type.

    Attributes:
        embodiment: the robot.
        action_type: joint or end-effector control.
        answers: an episode of one environment, then the first answers of a batch.
        near_limits: answers to a robot whose joints are near their limits; none for poses, and where no limits are
            known.
    """

    embodiment: Embodiment
    action_type: str
    answers: tuple[MotionAnswer, ...]
    near_limits: tuple[MotionAnswer, ...] = ()

    def problem(self, answer: MotionAnswer) -> str | None:
        """Return what is wrong with the form of an answer, or None."""
        return structure_problem(answer.chunk, self.embodiment, self.action_type)

    @property
    def sound(self) -> list[MotionAnswer]:
        """The answers whose values can be judged, because their form is right."""
        return [answer for answer in self.answers if self.problem(answer) is None]

    @property
    def sound_near_limits(self) -> list[MotionAnswer]:
        """Those near the limits whose values can be judged."""
        return [answer for answer in self.near_limits if self.problem(answer) is None]


class MotionEpisodes:
    """All motions of one adapter.

    Args:
        probe: the adapter.
    """

    def __init__(self, probe: Probe) -> None:
        self._probe = probe
        self.is_random = probe.has_tiny_weights
        self._scenario = environments.module("offline", "scenario")

    def require_trained(self) -> None:
        """Discard a finding about how far the policy moves the robot.

        Raises:
            NotApplicable: if its weights are tiny random ones.
        """
        if self.is_random:
            raise NotApplicable("the weights are tiny random ones: where they move the robot says nothing")

    @property
    def frequency(self) -> float:
        """The control rate that chunks are meant for, Hz: the manifest's, or else that of the observations."""
        declared = self._probe.package.manifest.control_frequency
        return float(declared or self._scenario.FREQUENCY)

    @cached_property
    def all(self) -> tuple[MotionEpisode, ...]:
        """One motion of every robot and action type that the manifest declares, the configured pair first."""
        episodes = []
        for name, action_type in self._probe.combinations():
            embodiment = get_embodiment(name)
            with self._probe.served_as(name, action_type) as policy:
                answers = tuple(self._run_episode(policy, embodiment, action_type))
                near_limits = tuple(self._run_near_limits(policy, embodiment, action_type))
            episodes.append(MotionEpisode(embodiment, action_type, answers, near_limits))
        return tuple(episodes)

    @property
    def sound(self) -> list[MotionEpisode]:
        """The motions in which there are values to judge.

        Raises:
            NotApplicable: if there is none.
        """
        episodes = [motion for motion in self.all if motion.sound]
        if not episodes:
            raise NotApplicable("no action has the form that the embodiment asks for")
        return episodes

    def _run_episode(self, policy: RecordedClient, embodiment: Embodiment, action_type: str) -> Iterator[MotionAnswer]:
        obs = self._probe.observation(embodiment=embodiment)
        chunk = policy.act(obs)
        yield MotionAnswer(obs, 0, chunk, batched=False)
        for step in range(1, _STEPS):
            if structure_problem(chunk, embodiment, action_type) is not None:
                return
            obs = self._scenario.advance(obs, chunk[0], step)
            problem = policy.update_obs(obs)
            chunk = problem if isinstance(problem, PolicyServerError) else policy.get_action()
            yield MotionAnswer(obs, step, chunk, batched=False)
        observations = [self._probe.observation(env, embodiment=embodiment) for env in _BATCH]
        policy.reset()
        policy.update_obs_batch(observations)
        chunks = policy.get_action_batch(list(_BATCH))
        if isinstance(chunks, (list, tuple)):  # whether a batch is answered at all, other rules ask
            for obs, chunk in zip(observations, chunks, strict=False):
                yield MotionAnswer(obs, 0, chunk, batched=True)

    def _run_near_limits(
        self, policy: RecordedClient, embodiment: Embodiment, action_type: str
    ) -> Iterator[MotionAnswer]:
        if sdk.ACTION_KEYS[action_type][0] != sdk.State.ARM_JOINT_STATE:
            return
        for first_is_high in (False, True) if any(arm.lower is not None for arm in embodiment.arms) else ():
            plain = self._probe.observation(embodiment=embodiment)
            obs = {
                **plain,
                sdk.Obs.STATE: {**plain[sdk.Obs.STATE], **_joints_near_limits(embodiment, first_is_high=first_is_high)},
            }
            yield MotionAnswer(obs, 0, policy.act(obs), batched=False)


def _joints_near_limits(embodiment: Embodiment, *, first_is_high: bool) -> dict[str, np.ndarray]:
    """Return joints near their limits, by turns the lower and the upper one."""
    joints = {}
    for arm in embodiment.arms:
        if arm.lower is not None and arm.upper is not None:
            is_high = (np.arange(arm.dof) % 2 == 1) ^ first_is_high
            share = np.where(is_high, 1.0 - _MARGIN, _MARGIN)
            joints[arm.prefix + sdk.State.ARM_JOINT_STATE] = (arm.lower + share * (arm.upper - arm.lower)).astype(
                np.float32
            )
    return joints
