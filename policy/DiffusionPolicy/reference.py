"""How LeRobot itself asks DiffusionPolicy's policy: its own preparation, its processors, its `select_action`.

`xpl model-io record` runs this, and audits hold the adapter to what it answers. It uses nothing of model.py, and of
policy.yml nothing.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

CONVENTIONS = {
    "image_channels": "huggingface/lerobot@v0.4.4:src/lerobot/cameras/opencv/configuration_opencv.py:62",
    "image_range": "huggingface/lerobot@v0.4.4:src/lerobot/policies/utils.py:130",
    "image_size": "assumed: config.json names 96 x 96, the size at which the demonstrations were recorded",
    "image_orientation": "assumed: LeRobot turns no image, and the demonstrations show what the cameras showed",
    "camera": "assumed: the head camera was recorded as observation.images.head, that of the wrist as .wrist",
    "gripper": "assumed: 0 closed and 1 open, as recorded",
    "rotation": "assumed: quaternions of the demonstrations, scalar first, as the first two rows of their matrix",
    "frame": "assumed: metres in the environment's world, as recorded",
    "point": "assumed: the flange, as recorded",
    "action_reference": "assumed: commanded poses as recorded, counted from nothing",
    "chunk": "huggingface/lerobot@v0.4.4:src/lerobot/policies/diffusion/modeling_diffusion.py:109",
    "normalization": "huggingface/lerobot@v0.4.4:src/lerobot/processor/normalize_processor.py:306",
    "sampling": "huggingface/lerobot@v0.4.4:src/lerobot/policies/diffusion/modeling_diffusion.py:204",
    "history_length": "huggingface/lerobot@v0.4.4:src/lerobot/policies/diffusion/modeling_diffusion.py:99",
    "history_order": "huggingface/lerobot@v0.4.4:src/lerobot/policies/diffusion/modeling_diffusion.py:99",
    "history_padding": "huggingface/lerobot@v0.4.4:src/lerobot/policies/utils.py:42",
    "history_stride": "huggingface/lerobot@v0.4.4:src/lerobot/policies/utils.py:46",
}

CAMERAS = {"observation.images.head": "cam_head", "observation.images.wrist": "cam_wrist"}


def state(observed: dict[str, Any]) -> np.ndarray:
    """Return observation.state, (10,): position, two rows of the rotation, opening."""
    place, (w, x, y, z) = observed["ee_pose"][:3], observed["ee_pose"][3:] / np.linalg.norm(observed["ee_pose"][3:])
    first = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
    second = [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
    return np.concatenate([place, first, second, observed["ee_joint_state"]]).astype(np.float32)


def command(row: np.ndarray) -> dict[str, np.ndarray]:
    """Return one action (10,) as a step of the standard."""
    first = row[3:6] / np.linalg.norm(row[3:6])
    second = row[6:9] - first * (first @ row[6:9])
    second /= np.linalg.norm(second)
    turned = np.stack([first, second, np.cross(first, second)])
    return {
        "ee_pose": np.concatenate([row[:3], quaternion(turned)]),
        "ee_joint_state": np.clip(row[9:10], 0.0, 1.0),
    }


def quaternion(matrix: np.ndarray) -> np.ndarray:
    """Return the unit quaternion of a rotation matrix, scalar first: the eigenvector of Bar-Itzhack's matrix (2000)."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    table = np.array(
        [
            [a - e - i, d + b, g + c, h - f],
            [d + b, e - a - i, h + f, c - g],
            [g + c, h + f, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    x, y, z, w = np.linalg.eigh(table)[1][:, -1]
    return np.array([w, x, y, z]) * (1.0 if w >= 0 else -1.0)


def answers(config: dict[str, Any]) -> Any:
    """Return what answers a question about an episode."""
    import torch
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors
    from lerobot.policies.utils import prepare_observation_for_inference

    checkpoint = str(Path(__file__).parent / "checkpoints" / config["ckpt_name"])
    settings = PreTrainedConfig.from_pretrained(checkpoint)
    settings.device = "cuda" if torch.cuda.is_available() else "cpu"
    policy = get_policy_class(settings.type).from_pretrained(checkpoint, config=settings)
    policy.eval()
    before, after = make_pre_post_processors(
        settings, checkpoint, preprocessor_overrides={"device_processor": {"device": settings.device}}
    )

    def prepared(observation: dict[str, Any]) -> Any:
        held = {name: np.ascontiguousarray(observation["vision"][one]["color"]) for name, one in CAMERAS.items()}
        held["observation.state"] = state(observation["state"])
        return before(prepare_observation_for_inference(held, torch.device(settings.device), ""))

    def answer(episode: Any) -> list[dict[str, np.ndarray]]:
        policy.reset()
        shape = (1, settings.horizon, settings.output_features["action"].shape[0])
        noise = torch.from_numpy(episode.rng.standard_normal(shape[1:], np.float32)).reshape(shape).to(settings.device)
        seen = episode.observations[-settings.n_obs_steps :]
        with torch.inference_mode():
            for observation in seen[:-1]:
                policy.select_action(prepared(observation), noise=noise)
                policy._queues["action"].clear()  # noqa: SLF001 - it is asked again at every observation here
            batch = prepared(seen[-1])
            rows = [after(policy.select_action(dict(batch), noise=noise)) for _ in range(settings.n_action_steps)]
        return [command(row[0].double().cpu().numpy()) for row in rows]

    return answer
