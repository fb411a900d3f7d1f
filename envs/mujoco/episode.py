"""One episode of one environment, from a seed to a result. A new episode shares nothing with the one before."""

from __future__ import annotations

import hashlib
from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.episode import MAX_STEPS, SUCCESS
from xpl.safety import NON_FINITE

from .control import ROTATION_ERROR, ActionReader, Control, Corrections
from .manifest import manifest_for
from .observe import segmentation, state, vision
from .physics import Physics
from .randomise import RANDOMIZED, decorate, instruction, rng_of, vary
from .renderers import Studio, native_size
from .scene import build_scene
from .task import load_task

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl.episode import Setup

    from .camera import Frame

_DIGITS = 6
UNSTABLE = "unstable_physics"


class Episode:
    """One episode.

    Args:
        setup: what it is played with.
        renderer: "raycast", "egl" or "osmesa".
        seed: decides everything that varies.
        env_idx: index of the environment it is played in.

    Attributes:
        physics: the scene in motion.
        cameras: what observations show, by name.
        end_reason: why it has ended; None while it goes on.
    """

    def __init__(self, setup: Setup, renderer: str, seed: int, env_idx: int) -> None:
        facts = manifest_for(len(setup.embodiment.arms))
        entry = facts["tasks"][setup.task]
        self._setup, self._seed, self._env_idx = setup, seed, env_idx
        variation = rng_of(seed)
        varied = setup.setting == RANDOMIZED
        if varied:
            facts = vary(facts, variation)
        self._frequency: float = facts["control_frequency"]
        scene = build_scene(setup.embodiment, facts)
        self._task = load_task(setup.task)(entry, facts["success"])
        self._task.lay_out(scene, np.random.default_rng(seed))
        if varied:
            decorate(scene, facts, variation, self._task.clear)
        wording: str = instruction(entry, variation) if varied else entry[spec.Obs.INSTRUCTION]
        self._instruction = wording.format(**self._task.words)
        self.physics = Physics(scene)
        self._reader = ActionReader(setup.embodiment, setup.action_type)
        self._control = self._ready(facts["ready"][setup.embodiment.name])
        self.physics.settle(facts["physics"]["settle_steps"])
        self._substeps = round(1.0 / (self._frequency * facts["physics"]["timestep"]))
        sizes = self._sizes(facts["cameras"])
        self._studio = Studio(self.physics.model, renderer)
        self.cameras = {name: self._studio.camera(name, size) for name, size in sizes.items()}
        self._previous = self.physics.flanges()
        self._corrections: Counter[str] = Counter()
        self._steps = 0
        self._digest = hashlib.sha256()
        self.physics.digest_into(self._digest)
        self.end_reason: str | None = None
        self._layout = _layout(self._task.truth(self.physics), self.physics.table_top)

    def observe(self) -> dict[str, Any]:
        """Return the present observation; a new one each time, which the caller may change."""
        setup = self._setup
        frames = {name: camera.render(self.physics.data) for name, camera in self.cameras.items()}
        result = {
            spec.Obs.DATA_FORMAT_VERSION: spec.DATA_FORMAT_VERSION,
            spec.Obs.INSTRUCTION: self._instruction,
            spec.Obs.ENV_IDX: self._env_idx,
            spec.Obs.ADDITIONAL_INFO: {spec.Obs.FREQUENCY: self._frequency},
            spec.Obs.VISION: vision(self.physics, self.cameras, frames),
            spec.Obs.STATE: state(self.physics, setup.embodiment, self._previous),
        }
        if setup.privileged:
            result[spec.Obs.PRIVILEGED] = {**self._truth(), **segmentation(self.physics, frames)}
        return result

    def render(self, camera: str, height: int, width: int) -> Frame:
        """Return what any camera of the scene sees now, in a picture of any size."""
        return self._studio.camera(camera, (height, width)).render(self.physics.data)

    def close(self) -> None:
        """Free what the cameras hold."""
        self._studio.close()

    def step(self, action: Mapping[str, Any]) -> dict[str, Any]:
        """Execute one action step, unless the episode has ended.

        Returns:
            the step's report: env_idx, step, end_reason, and per arm the corrections that were necessary.

        Raises:
            ActionError: keys or dimensions are not those of embodiment and action type. Nothing has moved then.
        """
        flat = self._reader.read(action)
        if self.end_reason is not None:
            return self._report({})
        if not np.isfinite(flat).all():
            # Physics never sees the value: a NaN in a command would spread through the whole state.
            self.end_reason = NON_FINITE
            return self._report({})
        corrections = self._control.execute(flat)
        physics = self.physics
        self._previous = physics.flanges()
        physics.drive(self._control.targets, self._substeps)
        physics.digest_into(self._digest)
        self._steps += 1
        self._judge()
        for correction in corrections.values():
            self._corrections.update(kind for kind in correction if kind != ROTATION_ERROR)
        return self._report(corrections)

    def result(self) -> dict[str, Any]:
        """Return the episode's outcome so far: plain values, ready for a report."""
        return {
            spec.Obs.ENV_IDX: self._env_idx,
            "task": self._setup.task,
            "setting": self._setup.setting,
            spec.Deploy.SEED: self._seed,
            spec.Obs.INSTRUCTION: self._instruction,
            "success": self._task.succeeded,
            "score": self._task.score,
            "stages": dict(self._task.stages),
            "steps": self._steps,
            "end_reason": self.end_reason,
            "corrections": dict(self._corrections),
            "layout": self._layout,
            "digest": self._digest.hexdigest(),
        }

    def _judge(self) -> None:
        if not self.physics.is_finite():
            self.end_reason = UNSTABLE
            return
        self._task.update(self.physics)
        if self._task.succeeded:
            self.end_reason = SUCCESS
        elif self._steps >= self._setup.max_steps:
            self.end_reason = MAX_STEPS

    def _report(self, corrections: Corrections) -> dict[str, Any]:
        return {
            spec.Obs.ENV_IDX: self._env_idx,
            "step": self._steps,
            "end_reason": self.end_reason,
            "corrections": corrections,
        }

    def _ready(self, poses: Mapping[str, Any]) -> Control:
        """Put every arm into the pose in which episodes start."""
        setup, physics = self._setup, self.physics
        starts = [np.array(poses[side], dtype=np.float64) for side in setup.embodiment.data["arms"]]
        for arm, start in enumerate(starts):
            physics.place(arm, start, spec.GRIPPER_OPEN)
        return Control(setup.embodiment, setup.action_type, physics.bases, starts, 1.0 / self._frequency)

    def _sizes(self, entries: Mapping[str, Any]) -> dict[str, tuple[int, int]]:
        """Return (height, width) of every camera whose pictures are observed."""
        size = self._setup.cameras
        if size is False:
            return {}
        cameras = self._setup.embodiment.cameras
        return {name: native_size(entries[name]) if size is True else size for name in cameras}

    def _truth(self) -> dict[str, Any]:
        """Return the privileged map: what README.md lists."""
        arms = zip(self._setup.embodiment.prefixes, self.physics.bases, strict=True)
        bases = {prefix + spec.State.BASE_POSE: base.copy() for prefix, base in arms}
        return {
            "task": self._setup.task,
            "table_top": self.physics.table_top,
            **bases,
            **self._task.truth(self.physics),
        }


def _layout(truth: Mapping[str, Any], table_top: float) -> dict[str, Any]:
    """Return what the seed drew, as plain numbers to a micrometre: poses of objects, places of goals, the table."""
    return {
        "table_top": round(float(table_top), _DIGITS),
        "objects": {name: _round_floats(entry["pose"]) for name, entry in truth["objects"].items()},
        "goals": {name: _round_floats(entry["position"]) for name, entry in truth["goals"].items()},
    }


def _round_floats(values: Any) -> list[float]:
    return [round(float(value), _DIGITS) + 0.0 for value in values]  # -0.0 becomes 0.0
