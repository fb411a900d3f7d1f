"""The correct adapter once more, derived from the base class of the SDK."""

import json

import numpy as np

from xpl import Policy
from xpl.checkpoint import resolve, resolve_step
from xpl.observation import get_image, get_instruction, pack_state


class Model(Policy):
    """Moves every joint a little, by an amount that depends on all inputs."""

    def load(self, config):
        folder = resolve_step(resolve(config, self.policy_dir), config.get("checkpoint_step"))
        self.offset = json.loads((folder / "weights.json").read_text())["offset"]
        self.gain = self.setting("gain", 1.0)
        self.mirror = self.setting("mirror", False)
        self.prompt = config.get("prompt")

    def encode(self, obs, env):
        instruction = self.prompt if self.prompt is not None else get_instruction(obs)
        if instruction is None:
            raise ValueError("the observation has no instruction")
        words = sum((place + 1) * ord(letter) for place, letter in enumerate(instruction)) % 997
        parts = [np.array([words / 997])]
        for camera in ("cam_head", "cam_left_wrist", "cam_right_wrist"):
            image = get_image(obs, camera)[:, :: -1 if self.mirror else 1]
            parts.append(image[::7, ::9].astype(float).ravel() / 255)
        here = pack_state(obs, self.embodiment, self.action_type)
        for kind in ("joint", "ee"):
            parts.append(canonical(pack_state(obs, self.embodiment, kind), self.embodiment, kind))
        return np.concatenate(parts), canonical(here, self.embodiment, self.action_type)

    def predict(self, inputs, envs):
        chunks = []
        for frames, env in zip(inputs, envs):
            features = np.concatenate([features for features, _ in frames])
            mixed = np.dot(np.cos(0.7 * np.arange(features.size)), features)
            noise = self.rng(env).normal()
            moves = 0.01 * np.sin(self.offset + self.gain * mixed + 0.1 * noise) * (np.arange(self.chunk) + 1) / self.chunk
            chunks.append([frames[-1][1] + move for move in moves])
        return np.array(chunks)

    def decode(self, raw, obs, env):
        lower, upper = limits(self.embodiment, self.action_type)
        return super().decode(np.clip(raw, lower, upper), obs, env)


def canonical(flat, robot, kind):
    """Return a flat action whose quaternions have a positive leading component."""
    flat, place = np.array(flat, dtype=float), 0
    for key, size in robot.dims(kind).items():
        if key.endswith("ee_pose"):
            quaternion = flat[place + 3 : place + 7] / np.linalg.norm(flat[place + 3 : place + 7])
            leading = quaternion[np.flatnonzero(np.abs(quaternion) > 1e-6)[0]]
            flat[place + 3 : place + 7] = quaternion if leading > 0 else -quaternion
        place += size
    return flat


def limits(robot, kind):
    """Return the lowest and the highest flat action."""
    lower, upper = [], []
    for arm in robot.arms:
        known = kind == "joint" and arm.lower is not None
        size = arm.dof if kind == "joint" else 7
        lower += [*(arm.lower if known else [-np.inf] * size), *[0.0] * arm.ee_dim]
        upper += [*(arm.upper if known else [np.inf] * size), *[1.0] * arm.ee_dim]
    return lower, upper
