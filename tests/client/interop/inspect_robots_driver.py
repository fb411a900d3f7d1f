"""Drives inspect-robots, with its xpolicylab plugin as the policy, through the public API of both.

Runs in the peers' interpreter, started by the tests; `lines` says how they talk. Nothing of this project is imported.
"""

from __future__ import annotations

import hashlib
import tempfile
from typing import Any

import numpy as np
from inspect_robots import (
    Action,
    ActionSemantics,
    Box,
    CameraSpec,
    EmbodimentBase,
    EmbodimentInfo,
    Observation,
    ObservationSpace,
    Scene,
    StepResult,
    Task,
    eval,  # noqa: A004 - its name there
    registry,
)
from lines import answer, hear, tell

IMAGE = (24, 32, 3)  # small, and not square: a swap of height and width would show
STATE_KEYS = ("joint_pos", "gripper", "eef_pose")


class Arms(EmbodimentBase):
    """Arms that are never where an earlier observation saw them: all that is observed is drawn anew at every step.

    Args:
        prefixes: of the state's keys, one for each arm.
        dof: joints of an arm.
        action_type: "joint" or "ee".
        pause: trial (from 0) and step before which the test is told and waited for.

    Attributes:
        trials: for each reset, the digests of all observations and the executed actions.
    """

    def __init__(self, prefixes: list[str], dof: int, action_type: str, pause: list[int] | None = None) -> None:
        joint = action_type == "joint"
        self.prefixes, self.dof, self.pause = prefixes, dof, pause
        self.trials: list[dict[str, Any]] = []
        self.info = EmbodimentInfo(
            name="arms",
            action_space=Box(
                shape=(len(prefixes) * ((dof if joint else 7) + 1),),
                semantics=ActionSemantics(
                    control_mode="joint_pos" if joint else "eef_abs_pose",
                    rotation_repr="none" if joint else "quat_wxyz",
                    gripper="continuous",
                ),
            ),
            observation_space=ObservationSpace(
                cameras=(CameraSpec("base_rgb", *IMAGE),),
                state_keys=frozenset(prefix + key for prefix in prefixes for key in STATE_KEYS),
            ),
            control_hz=25.0,
            is_simulated=True,
        )

    def reset(self, scene: Scene, *, seed: int | None = None) -> Observation:
        self.trials.append({"scene": scene.id, "instruction": scene.instruction, "observations": [], "actions": []})
        self.rng = np.random.default_rng(seed)
        return self.observe()

    def step(self, action: Action) -> StepResult:
        trial = self.trials[-1]
        if self.pause == [len(self.trials) - 1, len(trial["actions"])]:
            tell({"paused": self.pause})
            hear()
        trial["actions"].append(action.data.tolist())
        return StepResult(observation=self.observe())

    def observe(self) -> Observation:
        state = {}
        for prefix in self.prefixes:
            turn = self.rng.normal(size=4)
            state[prefix + "joint_pos"] = self.rng.uniform(-1, 1, self.dof).astype(np.float32)
            state[prefix + "gripper"] = self.rng.uniform(0, 1, 1).astype(np.float32)
            pose = np.concatenate([self.rng.uniform(-1, 1, 3), turn / np.linalg.norm(turn)])
            state[prefix + "eef_pose"] = pose.astype(np.float32)
        image = self.rng.integers(0, 256, IMAGE, dtype=np.uint8)
        parts = [state[prefix + key] for prefix in self.prefixes for key in STATE_KEYS]
        self.trials[-1]["observations"].append(
            {"digest": digest([*parts, image]), "state": {key: value.tolist() for key, value in state.items()}}
        )
        return Observation(images={"base_rgb": image}, state=state)


def digest(arrays: list[np.ndarray]) -> str:
    total = hashlib.sha256()
    for array in arrays:
        total.update(f"{array.dtype.str}{array.shape}".encode() + array.tobytes())
    return total.hexdigest()


class Session:
    def open(self, **options: Any) -> int:
        self.policy = registry.resolve("policy", "xpolicylab", **options)
        return int(self.policy.info.action_space.dim)

    def evaluate(self, scenes: list[str], steps: int, epochs: int = 1, **arms: Any) -> dict[str, Any]:
        body = Arms(**arms)
        listed = [Scene(id=f"scene-{index}", instruction=text) for index, text in enumerate(scenes)]
        task = Task(name="interop", scenes=listed, scorer="episode_length", max_steps=steps, epochs=epochs)
        with tempfile.TemporaryDirectory() as folder:
            (log,) = eval(task, self.policy, body, log_dir=folder)
        outcomes = [{"status": sample.status, "error": sample.error} for sample in log.samples]
        return {"status": log.status, "scenes": outcomes, "trials": body.trials, "steps": log.stats.total_steps}

    def reset(self, scene: str = "alone", instruction: str = "hold") -> None:
        self.policy.reset(Scene(id=scene, instruction=instruction))

    def act(self, prefixes: list[str], dof: int, action_type: str) -> list[list[float]]:
        first = Arms(prefixes, dof, action_type).reset(Scene(id="alone", instruction="hold"))
        return [action.data.tolist() for action in self.policy.act(first).actions]

    def close(self) -> None:
        self.policy.close()


if __name__ == "__main__":
    session = Session()
    answer({name: getattr(session, name) for name in ("open", "evaluate", "reset", "act", "close")})
