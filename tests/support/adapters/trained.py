"""Folders as trainings leave them behind: small, in their makers' formats, with numbers that can be told apart."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

ALOHA = [f"{side}_{joint}" for side in ("left", "right") for joint in (*(f"joint{n}" for n in range(1, 7)), "gripper")]
"""Names of the numbers of a robot with two arms of six joints and a gripper each."""


def put(folder: Path, name: str, value: Any) -> Path:
    """Write one file below a folder: text as it is, anything else as JSON."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(value if isinstance(value, str) else json.dumps(value, indent=2), encoding="utf-8")
    return path


def safetensors(path: Path, tensors: Mapping[str, Sequence[float] | np.ndarray]) -> None:
    """Write a safetensors file: eight bytes with the length of a JSON header, the header, the numbers."""
    header, body = {}, b""
    for name, values in tensors.items():
        data = np.asarray(values, np.float32)
        header[name] = {
            "dtype": "F32",
            "shape": list(data.shape),
            "data_offsets": [len(body), len(body) + data.nbytes],
        }
        body += data.tobytes()
    text = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + body)


def statistics(width: int, shift: float = 0.0) -> dict[str, list[float]]:
    """Return statistics of a vector, each number of which is another one."""
    low = [-0.5 - 0.01 * index + shift for index in range(width)]
    high = [0.5 + 0.02 * index + shift for index in range(width)]
    return {
        "min": low,
        "max": high,
        "mean": [(a + b) / 2 for a, b in zip(low, high, strict=True)],
        "std": [(b - a) / 4 for a, b in zip(low, high, strict=True)],
        "q01": [a + 0.05 for a in low],
        "q99": [b - 0.05 for b in high],
    }


COLOURS = {
    "mean": np.array([0.485, 0.456, 0.406]).reshape(3, 1, 1),
    "std": np.array([0.229, 0.224, 0.225]).reshape(3, 1, 1),
}
"""ImageNet's, in the shape that LeRobot keeps."""


def lerobot(
    folder: Path,
    kind: str = "act",
    *,
    width: int = 14,
    cameras: Mapping[str, tuple[int, int]] | None = None,
    modes: Mapping[str, str] | None = None,
    steps: Sequence[Mapping[str, Any]] = (),
    rename: Mapping[str, str] | None = None,
    **config: Any,
) -> Path:
    """Write a checkpoint as LeRobot's `save_pretrained` does, without its weights.

    Args:
        folder: where.
        kind: type of policy.
        width: numbers of state and action.
        cameras: name of an image to height and width.
        modes: normalisation by kind of feature.
        steps: further steps of the preprocessor, before the normalizer.
        rename: what the preprocessor renames.
        config: further keys of config.json.
    """
    cameras = {"observation.images.cam_high": (480, 640)} if cameras is None else cameras
    modes = modes or {"VISUAL": "MEAN_STD", "STATE": "MEAN_STD", "ACTION": "MEAN_STD"}
    images = {name: {"type": "VISUAL", "shape": [3, *size]} for name, size in cameras.items()}
    inputs = {"observation.state": {"type": "STATE", "shape": [width]}, **images}
    outputs = {"action": {"type": "ACTION", "shape": [width]}}
    put(
        folder,
        "config.json",
        {
            "type": kind,
            "n_obs_steps": 1,
            "input_features": inputs,
            "output_features": outputs,
            "normalization_mapping": dict(modes),
            **config,
        },
    )
    held = {"observation.state": statistics(width), "action": statistics(width, 0.1)}
    table = {f"{key}.{name}": values for key, numbers in held.items() for name, values in numbers.items()}
    table |= {f"{key}.{name}": values for key in images for name, values in COLOURS.items()}
    before = [
        {"registry_name": "rename_observations_processor", "config": {"rename_map": dict(rename or {})}},
        {"registry_name": "to_batch_processor", "config": {}},
        *map(dict, steps),
        _normalizer("normalizer_processor", {**inputs, **outputs}, modes, "policy_preprocessor", 2 + len(steps)),
    ]
    after = [_normalizer("unnormalizer_processor", outputs, modes, "policy_postprocessor", 0)]
    for name, listed in (("policy_preprocessor", before), ("policy_postprocessor", after)):
        put(folder, f"{name}.json", {"name": name, "steps": listed})
        safetensors(folder / next(step["state_file"] for step in listed if "state_file" in step), table)
    return folder


def _normalizer(name: str, features: Any, modes: Mapping[str, str], pipeline: str, place: int) -> dict[str, Any]:
    return {
        "registry_name": name,
        "config": {"eps": 1e-08, "features": features, "norm_map": dict(modes)},
        "state_file": f"{pipeline}_step_{place}_{name}.safetensors",
    }


def lerobot_dataset(
    folder: Path, names: Any = None, *, width: int = 14, robot: str = "aloha_agilex", fps: int = 30
) -> Path:
    """Write the `meta/` of a data set of LeRobot."""
    names = ALOHA if names is None else names
    features = {key: {"dtype": "float32", "shape": [width], "names": names} for key in ("observation.state", "action")}
    info = {"codebase_version": "v3.0", "robot_type": robot, "fps": fps, "features": features}
    put(folder, "meta/info.json", info)
    put(folder, "meta/stats.json", {"observation.state": statistics(width), "action": statistics(width, 0.1)})
    return folder


def openpi(folder: Path, *, width: int = 14, padded: int = 32, quantiles: bool = True, asset: str = "trossen") -> Path:
    """Write a checkpoint of openpi without its parameters: statistics of the padded vectors."""
    stats = {}
    for name, shift in (("state", 0.0), ("actions", 0.1)):
        held = statistics(width, shift)
        words = ("mean", "std", "q01", "q99") if quantiles else ("mean", "std")
        stats[name] = {word: [*held[word], *[0.0] * (padded - width)] for word in words}
    put(folder, f"assets/{asset}/norm_stats.json", {"norm_stats": stats})
    (folder / "params").mkdir(exist_ok=True)
    return folder


OPENPI_CONFIG = """
_CONFIGS = [
    TrainConfig(
        name="pi05_shirts",
        model=pi0_config.Pi0Config(pi05=True, action_horizon=25),
        data=LeRobotAlohaDataConfig(
            repo_id="somebody/shirts",
            use_delta_joint_actions=True,
            repack_transforms=_transforms.Group(
                inputs=[
                    _transforms.RepackTransform(
                        {"images": {"cam_high": "observation.images.top", "cam_left_wrist": "images.left_wrist"}}
                    )
                ]
            ),
        ),
    ),
]
"""


def groot(folder: Path, tag: str = "new_embodiment", **kwargs: Any) -> Path:
    """Write the processor of a checkpoint of GR00T N1.6 or newer, for two arms of six joints."""
    groups = {"left_arm": 6, "left_gripper": 1, "right_arm": 6, "right_gripper": 1}
    absolute = {"rep": "ABSOLUTE", "type": "NON_EEF", "format": "DEFAULT", "state_key": None}
    modalities = {
        "video": {"delta_indices": [0], "modality_keys": ["ego_view", "left_wrist"]},
        "state": {"delta_indices": [0], "modality_keys": list(groups)},
        "action": {
            "delta_indices": list(range(16)),
            "modality_keys": list(groups),
            "action_configs": [absolute for _ in groups],
        },
        "language": {"delta_indices": [0], "modality_keys": ["annotation.human.task_description"]},
    }
    put(
        folder,
        "processor_config.json",
        {
            "processor_class": "Gr00tN1d6Processor",
            "processor_kwargs": {
                "modality_configs": {tag: modalities},
                "use_percentiles": False,
                "formalize_language": True,
                **kwargs,
            },
        },
    )
    held = {kind: {group: statistics(count) for group, count in groups.items()} for kind in ("state", "action")}
    put(folder, "statistics.json", {tag: held})
    return folder


def groot_older(folder: Path, tag: str = "new_embodiment") -> Path:
    """Write the metadata of a checkpoint of GR00T N1 or N1.5, for one arm of six joints."""
    groups = {"single_arm": 6, "gripper": 1}
    about = {
        group: {"absolute": True, "rotation_type": None, "shape": [n], "continuous": True}
        for group, n in groups.items()
    }
    metadata = {
        "statistics": {kind: {group: statistics(n) for group, n in groups.items()} for kind in ("state", "action")},
        "modalities": {
            "video": {"front": {"resolution": [640, 480], "channels": 3, "fps": 30.0}},
            "state": about,
            "action": about,
        },
        "embodiment_tag": tag,
    }
    put(folder, "experiment_cfg/metadata.json", {tag: metadata})
    put(folder, "config.json", {"model_type": "gr00t_n1_5", "action_horizon": 16, "action_dim": 32})
    return folder


def openvla(folder: Path, data: Sequence[str] = ("libero_spatial_no_noops",), *, oft: bool = False) -> Path:
    """Write a checkpoint of OpenVLA, or of OpenVLA-OFT with its heads, without weights."""
    numbers = {**statistics(7), "mask": [True] * 6 + [False]}
    stats = {name: {"action": numbers, "proprio": statistics(8)} for name in data}
    put(folder, "config.json", {"model_type": "openvla", "image_sizes": [224, 224], "norm_stats": stats})
    if oft:
        put(folder, "dataset_statistics.json", stats)
        for name in ("action_head--1000_checkpoint.pt", "proprio_projector--1000_checkpoint.pt"):
            put(folder, name, "a pickle")
    return folder


def starvla(folder: Path) -> Path:
    """Write a run of StarVLA."""
    put(
        folder,
        "config.yaml",
        "framework:\n  name: QwenGR00T\n  action_model: {action_dim: 14, action_horizon: 16}\n"
        "datasets:\n  vla_data:\n    data_mix: shirts\n    include_state: true\n    obs_image_size: [224, 224]\n"
        "    action_type: abs_qpos\n",
    )
    put(folder, "dataset_statistics.json", {"arx": {"state": statistics(14), "action": statistics(14)}})
    put(folder, "checkpoints/steps_1000_pytorch_model.pt", "a pickle")
    return folder


def rdt(folder: Path) -> Path:
    """Write the config.json of RDT."""
    put(
        folder,
        "config.json",
        {
            "action_dim": 128,
            "pred_horizon": 64,
            "config": {"rdt": {"hidden_size": 2048, "depth": 28, "num_heads": 32}},
            "lang_token_dim": 4096,
            "img_token_dim": 1152,
            "state_token_dim": 128,
            "max_lang_cond_len": 1024,
            "img_pos_embed_config": [["image", [2, 3, -729]]],
        },
    )
    return folder


DIFFUSION_POLICY = """
_target_: diffusion_policy.workspace.train_diffusion_unet_hybrid_workspace.TrainDiffusionUnetHybridWorkspace
task_name: ${task.name}
shape_meta: ${task.shape_meta}
horizon: 16
n_obs_steps: 2
n_action_steps: 8
task:
  name: lift_image
  abs_action: true
  shape_meta:
    obs:
      agentview_image: {shape: [3, 84, 84], type: rgb}
      robot0_eye_in_hand_image: {shape: [3, 84, 84], type: rgb}
      robot0_eef_pos: {shape: [3]}
      robot0_eef_quat: {shape: [4]}
      robot0_gripper_qpos: {shape: [2]}
    action: {shape: [10]}
  env_runner:
    max_steps: ${eval:'500 if True else 400'}
  dataset: {rotation_rep: rotation_6d}
"""


def diffusion_policy(folder: Path) -> Path:
    """Write a run of Diffusion Policy: hydra's configuration, and a checkpoint that nobody may unpickle."""
    import zipfile

    put(folder, ".hydra/config.yaml", DIFFUSION_POLICY)
    (folder / "checkpoints").mkdir(exist_ok=True)
    with zipfile.ZipFile(folder / "checkpoints" / "latest.ckpt", "w") as archive:
        archive.writestr("latest/data.pkl", f"cos\nsystem\n(S'touch {folder}/unpickled'\ntR.")
        archive.writestr("latest/data/0", b"0")
    return folder


def robomimic(folder: Path, **train: Any) -> Path:
    """Write a run of robomimic."""
    put(
        folder,
        "config.json",
        {
            "algo_name": "bc",
            "train": {
                "action_keys": ["actions"],
                "action_config": {"actions": {"normalization": None}},
                "hdf5_normalize_obs": False,
                "frame_stack": 1,
                **train,
            },
            "algo": {"rnn": {"enabled": True}, "gmm": {"enabled": True}},
            "observation": {
                "modalities": {
                    "obs": {
                        "low_dim": ["robot0_eef_pos", "robot0_eef_quat", "robot0_gripper_qpos", "object"],
                        "rgb": ["agentview_image"],
                    }
                }
            },
        },
    )
    put(folder, "models/model_epoch_600.pth", "a pickle")
    return folder
