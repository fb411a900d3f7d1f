"""A cheap environment and an adapter for runs that are recorded: seeds and files tell what goes wrong in an episode."""

from __future__ import annotations

import json
import shutil
import textwrap
from pathlib import Path
from typing import Any

from tests.support.checkout import ROOT

STEPS = 6
WINS = frozenset({0, 1, 3, 4, 6, 7, 9, 10})
"""Seeds below 12 whose episodes succeed, where nothing goes wrong."""

_ENVIRONMENT = """
    import hashlib, os, signal
    from pathlib import Path
    import numpy as np

    HERE = Path(__file__).parent


    def due(name):
        '''Tell whether an event is due, and count it.'''
        marks = HERE / name
        left = int(marks.read_text()) if marks.exists() else 0
        if left:
            marks.write_text(str(left - 1))
        return bool(left)


    class Env:
        guarded = True

        def __init__(self, config):
            self.config = config

        def reset(self, seed=None, options=None):
            (self.seed,), self.steps = seed, 0
            self.joints = np.array([0, 0, 0, -1, 0, 1, 0.001 * self.seed], np.float32)
            self.digest = hashlib.sha256(self.joints.tobytes())

        def get_obs(self):
            return self.get_obs_batch([0])[0]

        def get_obs_batch(self, env_idx_list=None, last_frame=False):
            state = {"arm_joint_state": self.joints.copy(), "ee_joint_state": np.ones(1, np.float32)}
            return [{"env_idx": 0, "instruction": f"seed {self.seed}", "state": state}]

        def take_action(self, action):
            self.joints = np.asarray(action["arm_joint_state"], np.float32)
            self.digest.update(self.joints.tobytes())
            self.steps += 1
            if self.steps == 2 and due(f"env-dies-{self.seed}"):
                os.kill(os.getpid(), signal.SIGKILL)

        def take_action_batch(self, actions, env_idx_list):
            self.take_action(actions[0])

        def is_episode_end(self):
            return not self.get_running_env_idx_list()

        def get_running_env_idx_list(self):
            return [0] if self.steps < STEPS else []

        def results(self):
            won = bool(self.seed % 3 != 2) and self.steps == STEPS
            return [{
                "env_idx": 0, "seed": self.seed, "success": won, "score": 1.0 if won else 0.25, "steps": self.steps,
                "end_reason": None if self.steps < STEPS else "success" if won else "max_steps",
                "instruction": f"seed {self.seed}", "stages": {"moved": True, "done": won}, "corrections": {},
                "layout": {"place": self.seed}, "digest": self.digest.hexdigest(),
            }]

        def render(self, env_idx=0, camera=None):
            if due("blind"):
                raise RuntimeError("there is nothing to draw with")
            return np.full((12, 16, 3), 40 * self.steps, np.uint8)

        def close(self):
            pass


    def make(config):
        return Env(config)
"""

_MODEL = """
    import os, signal, time
    from pathlib import Path
    import numpy as np


    class Model:
        def __init__(self, config):
            self.config = config
            if self.due("does-not-load"):
                raise RuntimeError("the weights are gone")
            with (Path(config["marks"]) / "loads").open("a") as stream:
                stream.write("x")

        def due(self, event):
            marks = Path(self.config["marks"]) / event
            left = int(marks.read_text()) if marks.exists() else 0
            if left:
                marks.write_text(str(left - 1))
            return bool(left)

        def reset(self):
            self.calls = 0

        def update_obs(self, obs):
            self.seed = int(obs["instruction"].removeprefix("seed "))
            self.joints = obs["state"]["arm_joint_state"]

        def update_obs_batch(self, obs_list):
            self.update_obs(obs_list[-1])

        def get_action(self):
            self.calls += 1
            if self.calls == 2:
                self.fail()
            joints = np.asarray(self.joints, np.float32) + np.float32(0.01)
            gripper = np.ones(1, np.float32)
            return [{"arm_joint_state": joints, "ee_joint_state": gripper} for _ in range(2)]

        def fail(self):
            if self.seed in (self.config.get("raises") or []):
                raise RuntimeError(f"no idea what to do about {self.seed}")
            if self.due(f"policy-dies-{self.seed}"):
                os.kill(os.getpid(), signal.SIGKILL)
            if self.due(f"policy-hangs-{self.seed}"):
                time.sleep(600)
            marks = Path(self.config["marks"])
            ending = marks / "policy-dies-for-good"
            while ending.exists() and len((marks / "loads").read_text()) < 2:
                time.sleep(0.01)  # the other one may be loaded late
            try:
                ending.unlink()  # by one of them
            except FileNotFoundError:
                return
            (marks / "does-not-load").write_text("3")
            os.kill(os.getpid(), signal.SIGKILL)
"""


def environment(
    folder: Path, tasks: tuple[str, ...] = ("hold", "wait"), settings: tuple[str, ...] = ("clean",)
) -> Path:
    """Write the environment below `envs/` of a folder, and return its own."""
    place = folder / "envs" / "drill"
    place.mkdir(parents=True)
    facts = {
        "spec": "v1", "name": "drill", "title": "Drill", "embodiments": ["franka_single"], "action_types": ["joint"],
        "cameras": {"cam_third_view": {"width": 16, "height": 12}}, "control_frequency": 25, "client": "client.py",
        "settings": list(settings),
        "tasks": {task: {"instruction": task, "max_steps": STEPS, "dimension": "patience"} for task in tasks},
    }  # fmt: skip
    (place / "env.yml").write_text(json.dumps(facts), encoding="utf-8")
    code = textwrap.dedent(_ENVIRONMENT).replace("STEPS", str(STEPS))
    (place / "client.py").write_text(code, encoding="utf-8")
    return place


def adapter(folder: Path, **config: Any) -> Path:
    """Write the adapter, with the loop of the reference, below a folder, and return its own."""
    place = folder / "policy" / "Drilled"
    place.mkdir(parents=True)
    (place / "model.py").write_text(textwrap.dedent(_MODEL), encoding="utf-8")
    deploy = {"env_cfg_type": "franka_single", "action_type": "joint", "marks": str(folder), **config}
    (place / "deploy.yml").write_text(json.dumps(deploy), encoding="utf-8")
    shutil.copy(ROOT / "policy" / "demo_policy" / "deploy.py", place)
    return place


def mark(place: Path, event: str, times: int) -> None:
    """Let an event happen so many times.

    In the environment `env-dies-SEED` and `blind` (cannot be filmed); in the folder of all `policy-dies-SEED`,
    `policy-hangs-SEED`, and `policy-dies-for-good`: once two of them were loaded, one, and then it cannot be loaded for
    the next three times.
    """
    (place / event).write_text(str(times), encoding="utf-8")
