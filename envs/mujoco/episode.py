"""One episode of one environment, from a seed to a result. A new episode shares nothing with the one before."""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.action import ActionError, pack

from .backdrop import Backdrop
from .camera import Frame, RayCamera
from .control import ArmControl, execute
from .manifest import manifest
from .observe import flange_poses, state, vision
from .physics import Physics
from .scene import BACKDROP_GROUP, build_scene
from .task import load_task

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl.embodiment import Embodiment

SUCCESS, MAX_STEPS, NON_FINITE, UNSTABLE = "success", "max_steps", "non_finite_action", "unstable_physics"


@dataclass(frozen=True)
class Setup:
    """What an episode is played with.

    Attributes:
        task: name of the task.
        embodiment: the robot.
        action_type: "joint" or "ee".
        max_steps: control steps after which the episode ends.
        camera_size: (height, width) of every camera; None for none; "native" for the manifest's.
        privileged: whether observations show the simulator's truth.
    """

    task: str
    embodiment: Embodiment
    action_type: str
    max_steps: int
    camera_size: tuple[int, int] | str | None
    privileged: bool


class Episode:
    """One episode.

    Args:
        setup: what it is played with.
        seed: decides everything that varies.
        env_idx: index of the environment it is played in.
    """

    def __init__(self, setup: Setup, seed: int, env_idx: int) -> None:
        facts = manifest()
        self._setup, self._seed, self._env_idx = setup, seed, env_idx
        self._instruction: str = facts["tasks"][setup.task][spec.Obs.INSTRUCTION]
        self._frequency: float = facts["control_frequency"]
        scene = build_scene(setup.embodiment, facts)
        self._task = load_task(setup.task)(facts["tasks"][setup.task], facts["success"])
        self._task.lay_out(scene, np.random.default_rng(seed))
        self._physics = Physics(scene)
        self._controls = self._ready(facts["ready"][setup.embodiment.name])
        self._physics.settle(facts["physics"]["settle_steps"])
        self._substeps = round(1.0 / (self._frequency * facts["physics"]["timestep"]))
        self._cameras = self._open_cameras(facts["cameras"])
        self._previous = flange_poses(self._physics)
        self._corrections: Counter[str] = Counter()
        self._steps = 0
        self._digest = hashlib.sha256()
        self._physics.digest_into(self._digest)
        self.end_reason: str | None = None

    def observe(self) -> dict[str, Any]:
        """Return the present observation; a new one each time, which the caller may change."""
        setup = self._setup
        result = {
            spec.Obs.DATA_FORMAT_VERSION: spec.DATA_FORMAT_VERSION,
            spec.Obs.INSTRUCTION: self._instruction,
            spec.Obs.ENV_IDX: self._env_idx,
            spec.Obs.ADDITIONAL_INFO: {spec.Obs.FREQUENCY: self._frequency},
            spec.Obs.VISION: vision(self._physics, self._cameras),
            spec.Obs.STATE: state(self._physics, setup.embodiment, self._previous),
        }
        if setup.privileged:
            result[spec.Obs.PRIVILEGED] = self._truth()
        return result

    def render(self, camera: str, height: int, width: int) -> Frame:
        """Return what any camera of the scene sees now, at any resolution."""
        physics = self._physics
        return RayCamera(physics.model, camera, width, height, self._backdrop()).render(physics.data)

    def step(self, action: Mapping[str, Any]) -> dict[str, Any]:
        """Execute one action step, unless the episode has ended.

        Returns:
            the step's report: env_idx, step, end_reason, and per arm the corrections that were necessary.

        Raises:
            ActionError: keys or dimensions are not those of embodiment and action type. Nothing has moved then.
        """
        setup = self._setup
        flat = _flat(action, setup.embodiment, setup.action_type)
        if self.end_reason is not None:
            return self._report({})
        if not np.isfinite(flat).all():
            # Physics never sees the value: a NaN in a command would spread through the whole state.
            self.end_reason = NON_FINITE
            return self._report({})
        self._previous = flange_poses(self._physics)
        corrections = execute(self._controls, flat, setup.embodiment, setup.action_type)
        for arm, control in enumerate(self._controls):
            self._physics.command(arm, control.joints, control.opening)
        self._physics.step(self._substeps)
        self._physics.digest_into(self._digest)
        self._steps += 1
        self._judge()
        arms = {arm.prefix: item.report() for arm, item in zip(setup.embodiment.arms, corrections, strict=True)}
        self._corrections.update(kind for item in corrections for kind in item.excess)
        return self._report({prefix: report for prefix, report in arms.items() if report})

    def result(self) -> dict[str, Any]:
        """Return the episode's outcome so far: plain values, ready for a report."""
        return {
            spec.Obs.ENV_IDX: self._env_idx,
            "task": self._setup.task,
            spec.Deploy.SEED: self._seed,
            spec.Obs.INSTRUCTION: self._instruction,
            "success": self._task.succeeded,
            "score": self._task.score,
            "stages": dict(self._task.stages),
            "steps": self._steps,
            "end_reason": self.end_reason,
            "corrections": dict(self._corrections),
            "digest": self._digest.hexdigest(),
        }

    def _judge(self) -> None:
        if not self._physics.is_finite():
            self.end_reason = UNSTABLE
            return
        self._task.update(self._physics)
        if self._task.succeeded:
            self.end_reason = SUCCESS
        elif self._steps >= self._setup.max_steps:
            self.end_reason = MAX_STEPS

    def _report(self, corrections: dict[str, dict[str, float]]) -> dict[str, Any]:
        return {
            spec.Obs.ENV_IDX: self._env_idx,
            "step": self._steps,
            "end_reason": self.end_reason,
            "corrections": corrections,
        }

    def _ready(self, poses: Mapping[str, Any]) -> tuple[ArmControl, ...]:
        """Put every arm into the pose in which episodes start."""
        controls = []
        embodiment = self._setup.embodiment
        for arm, side in enumerate(embodiment.data["arms"]):
            start = np.array(poses[side])
            control = ArmControl(embodiment.data, self._physics.bases[arm], start, 1.0 / self._frequency)
            self._physics.place(arm, control.joints, control.opening)
            controls.append(control)
        return tuple(controls)

    def _open_cameras(self, entries: Mapping[str, Any]) -> dict[str, RayCamera]:
        size = self._setup.camera_size
        if size is None:
            return {}
        backdrop = self._backdrop()
        cameras = {}
        for name in self._setup.embodiment.cameras:
            height, width = (entries[name]["height"], entries[name]["width"]) if isinstance(size, str) else size
            cameras[name] = RayCamera(self._physics.model, name, width, height, backdrop)
        return cameras

    def _backdrop(self) -> Backdrop:
        return Backdrop(self._physics.model, self._physics.data, BACKDROP_GROUP)

    def _truth(self) -> dict[str, Any]:
        """Return the privileged map: what README.md lists."""
        arms = zip(self._setup.embodiment.prefixes, self._physics.bases, strict=True)
        bases = {prefix + spec.State.BASE_POSE: base.copy() for prefix, base in arms}
        return {
            "task": self._setup.task,
            "table_top": self._physics.table_top,
            **bases,
            **self._task.truth(self._physics),
        }


def _flat(action: Mapping[str, Any], embodiment: Embodiment, action_type: str) -> np.ndarray:
    """Return the action as float64 vector, checked for exactly its keys."""
    known = embodiment.dims(action_type)
    extra = [key for key in action if key not in known]
    if extra:
        raise ActionError(
            f"the action has {', '.join(map(str, extra))}, which {action_type} control of {embodiment.name} "
            f"does not know: send exactly {', '.join(known)}"
        )
    return pack(action, embodiment, action_type).astype(np.float64)
