"""A correct adapter that is written by hand: what the mutants spoil.

A small fixed function of everything an observation holds. It has what real adapters have and get wrong: a history, one
random generator for each environment, a checkpoint with steps and statistics, settings, both action types, any number
of arms and joints.
"""

import json
from collections import deque
from pathlib import Path

import numpy as np

from xpl import get_embodiment
from xpl.checkpoint import resolve, resolve_step
from xpl.observation import get_image, get_instruction

HERE = Path(__file__).resolve().parent
CHUNK = 4
HISTORY = 2
CONTROL_FREQUENCY = 25.0
TRAVEL = 0.01
CELLS = 4


class Model:
    """Moves every joint a little, by an amount that depends on all inputs."""

    def __init__(self, config):
        self.robot = get_embodiment(config["env_cfg_type"])
        self.action_type = config["action_type"]
        if self.action_type not in ("joint", "ee"):
            raise ValueError(f"action_type must be joint or ee, got {self.action_type!r}")
        seed = config.get("seed")
        self.seed = 0 if seed is None else seed
        mirror = config.get("mirror")
        self.mirror = False if mirror is None else mirror
        if not isinstance(self.mirror, bool):
            raise ValueError(f"mirror must be true or false, got {mirror!r}")
        gain = config.get("gain")
        self.gain = 1.0 if gain is None else float(gain)
        self.prompt = config.get("prompt")
        folder = resolve_step(resolve(config, HERE), config.get("checkpoint_step"))
        weights = json.loads((folder / "weights.json").read_text())
        self.frequencies = np.array(weights["frequencies"])
        self.offset = weights["offset"]
        statistics = json.loads((folder / "statistics.json").read_text())
        self.mean, self.std = statistics["mean"], statistics["std"]
        self.history = {}
        self.newest = {}
        self.generators = {}
        self.order = None

    def update_obs(self, obs):
        self._observe([obs], [obs.get("env_idx", 0)])

    def update_obs_batch(self, obs_list):
        missing = ["env_idx" not in obs for obs in obs_list]
        if any(missing) and not all(missing):
            raise ValueError("some observations have env_idx and some have not")
        envs = [index if absent else obs["env_idx"] for index, (obs, absent) in enumerate(zip(obs_list, missing))]
        if len(set(envs)) != len(envs):
            raise ValueError(f"an environment is repeated in {envs}")
        self._observe(obs_list, envs)

    def _observe(self, obs_list, envs):
        encoded = [self._encode(obs) for obs in obs_list]
        for env, (features, state) in zip(envs, encoded):
            self.history.setdefault(env, deque(maxlen=HISTORY)).append(features)
            self.newest[env] = state
            if env not in self.generators:
                self.generators[env] = np.random.default_rng([self.seed, env])
        self.order = list(envs)

    def get_action(self):
        if self.order is None:
            raise RuntimeError("get_action needs an observation since the last reset")
        if len(self.order) != 1:
            raise RuntimeError(f"get_action answers one environment, the last batch held {self.order}")
        return self._chunk(self.order[0])

    def get_action_batch(self, env_idx_list=None):
        if env_idx_list is None:
            if self.order is None:
                raise RuntimeError("get_action_batch needs an observation since the last reset")
            env_idx_list = self.order
        if len(set(env_idx_list)) != len(env_idx_list):
            raise ValueError(f"an environment is repeated in {env_idx_list}")
        unknown = [env for env in env_idx_list if env not in self.history]
        if unknown:
            raise ValueError(f"no observation of the environments {unknown} since the last reset")
        return [self._chunk(env) for env in env_idx_list]

    def reset(self):
        self.history.clear()
        self.newest.clear()
        self.generators.clear()
        self.order = None

    # -- inside

    def _encode(self, obs):
        """Return the features of an observation and its state, part by part."""
        instruction = self.prompt if self.prompt is not None else get_instruction(obs)
        if instruction is None:
            raise ValueError("the observation has no instruction")
        words = sum((place + 1) * ord(letter) for place, letter in enumerate(instruction)) % 997 / 997
        features = [np.array([words])]
        for camera in ("cam_head", "cam_left_wrist", "cam_right_wrist"):
            image = get_image(obs, camera)
            if self.mirror:
                image = image[:, ::-1]
            features.append(self._shrink(image).ravel() / 255)
        state = self._state(obs["state"])
        features.extend((values - self.mean) / self.std for values in state.values())
        return np.concatenate(features), state

    def _shrink(self, image):
        """Return the mean colour of every cell of a grid, (CELLS, CELLS, 3)."""
        height, width = (size // CELLS * CELLS for size in image.shape[:2])
        cut = image[:height, :width].astype(np.float64)
        return cut.reshape(CELLS, height // CELLS, CELLS, width // CELLS, 3).mean(axis=(1, 3))

    def _state(self, state):
        values = {}
        for arm in self.robot.arms:
            for name, size in (("arm_joint_state", arm.dof), ("ee_pose", 7), ("ee_joint_state", arm.ee_dim)):
                key = arm.prefix + name
                if key not in state:
                    raise KeyError(f"the observation has no state {key}; it has {sorted(state)}")
                value = np.array(state[key])
                if value.dtype.kind not in "fiu":
                    raise ValueError(f"state {key} must hold numbers, got {value.dtype}")
                value = value.astype(np.float64)
                if value.shape != (size,):
                    raise ValueError(f"state {key} must have the shape ({size},), got {value.shape}")
                if not np.isfinite(value).all():
                    raise ValueError(f"state {key} is not finite: {value}")
                if name == "ee_pose":
                    value[3:] = canonical(value[3:])
                values[key] = value
        return values

    def _chunk(self, env):
        frames = list(self.history[env])
        frames = [frames[0]] * (HISTORY - len(frames)) + frames
        features = np.concatenate(frames)
        noise = self.generators[env].normal()
        steps = []
        for step in range(CHUNK):
            move = self._move(features, noise, step)
            steps.append(self._step(self.newest[env], move))
        return steps

    def _move(self, features, noise, step):
        """Return a number in -TRAVEL..TRAVEL in which every feature shows."""
        mixed = np.dot(np.cos(np.arange(features.size) * self.frequencies[0] + self.frequencies[1]), features)
        wave = np.sin(self.offset + self.gain * mixed + 0.1 * noise + 0.05 * step)
        return TRAVEL * wave * (step + 1) / CHUNK

    def _step(self, state, move):
        action = {}
        for arm in self.robot.arms:
            if self.action_type == "joint":
                key = arm.prefix + "arm_joint_state"
                target = state[key] + move * np.linspace(0.5, 1.0, arm.dof)
                if arm.lower is not None:
                    target = np.clip(target, arm.lower, arm.upper)
                action[key] = target.astype(np.float32)
            else:
                key = arm.prefix + "ee_pose"
                pose = state[key].copy()
                pose[:3] += move * np.array([0.3, 0.2, 0.1])
                pose[3:] = turned(pose[3:], move)
                action[key] = pose.astype(np.float32)
            key = arm.prefix + "ee_joint_state"
            action[key] = np.clip(state[key] + move, 0.0, 1.0).astype(np.float32)
        return action


def canonical(quaternion):
    """Return a unit quaternion, the one of the two of its rotation whose first component that is not zero is positive."""
    quaternion = quaternion / np.linalg.norm(quaternion)
    leading = quaternion[np.flatnonzero(np.abs(quaternion) > 1e-6)[0]]
    return quaternion if leading > 0 else -quaternion


def turned(quaternion, angle):
    """Return a rotation [w, x, y, z] after a further small turn about the world's z axis."""
    w, x, y, z = quaternion
    c, s = np.cos(angle / 2), np.sin(angle / 2)
    return np.array([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])
