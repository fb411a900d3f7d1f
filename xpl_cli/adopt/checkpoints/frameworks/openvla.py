"""OpenVLA and OpenVLA-OFT: `dataset_statistics.json`, or `norm_stats` in config.json, and the heads' weights.

Source: openvla/openvla prismatic/extern/hf/modeling_prismatic.py (predict_action), prismatic/extern/hf/
configuration_prismatic.py; moojink/openvla-oft experiments/robot/openvla_utils.py and prismatic/vla/constants.py. The
model's images are the inputs of its processor: 224 x 224 uint8.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.checkpoints.layout import DataRange, VectorNumbers
from xpl_cli.adopt.checkpoints.trained_model import ImageSpec, TrainedModel, VectorSpec, upstream
from xpl_cli.adopt.facts import Evidence, Fact, Tree, UnknownFact, assumed, certain, likely
from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from xpl_cli.adopt.checkpoints.reading import CheckpointFolder, ConfigDocument

NAME: Final = "openvla"
CODE: Final = "openvla/openvla@c8f03f4:prismatic"
OFT: Final = "moojink/openvla-oft@213c5ff"
_CONFIG: Final = "config.json"
_STATISTICS: Final = "dataset_statistics.json"
_POSE: Final = ("x", "y", "z", "roll", "pitch", "yaw", "gripper")
"""The seven numbers of an action in Open X-Embodiment data (EEF_POS): deltas, and the gripper."""
_CHUNKS: Final = {"libero": 8, "aloha": 25, "bridge": 5}
"""NUM_ACTIONS_CHUNK of openvla-oft by the platform in the dataset's name (prismatic/vla/constants.py)."""
_ALOHA: Final = 14


def inner(folder: CheckpointFolder) -> CheckpointFolder | None:
    """Return the folder of a checkpoint of OpenVLA; None if it is none."""
    if not folder.has(_CONFIG):
        return None
    return folder if folder.json(_CONFIG).at("model_type") == "openvla" else None


def read(folder: CheckpointFolder, key: str | None = None) -> TrainedModel:
    """Read a checkpoint.

    Args:
        folder: with config.json.
        key: unnorm_key, if the statistics are of several datasets.

    Raises:
        UserError: a file is invalid, or there are several datasets and `key` is None.
    """
    config = folder.json(_CONFIG)
    own = folder.has(_STATISTICS)
    stats = folder.json(_STATISTICS) if own else config
    above = () if own else ("norm_stats",)
    dataset = stats.choose_entry(stats.get(dict, *above, default={}), key)
    heads = [
        name
        for pattern in ("*action_head*", "proprio_projector*", "noisy_action_projector*")
        for name in folder.names(pattern)
    ]
    path = (*above, dataset, "action")
    action = _numbers(stats, path)
    reads_state = any(name.startswith("proprio") for name in heads)
    return TrainedModel(
        framework=NAME,
        about=f"OpenVLA{'-OFT' if heads else ''}, trained on {dataset}",
        family=certain("vla", config.evidence_of("model_type")),
        views=[_view(config, wrist=reads_state, oft=bool(heads))],
        states=[_state(stats, (*above, dataset, "proprio"))] if reads_state else [],
        action=VectorSpec(action, None, _rule(stats, path, oft=bool(heads), is_action=True)),
        reference=_reference(action),
        chunk=_chunk(dataset, heads),
        sampling=_sampling(heads),
        instruction={
            "input": likely("prompt", Evidence(f"{OFT}:experiments/robot/openvla_utils.py", None, "get_vla_action")),
            "template": likely(
                "In: What action should the robot take to {instruction}?\nOut:",
                Evidence(f"{OFT}:experiments/robot/openvla_utils.py", None, "prompt = ..."),
            ),
            "case": likely("lower", Evidence(f"{OFT}:experiments/robot/openvla_utils.py", None, "task_label.lower()")),
        },
        robot=None,
        upstream=upstream("moojink/openvla-oft" if heads else "openvla/openvla", "MIT"),
        code=[
            likely(
                "images pass through JPEG; then a subpixel centre crop of 0.9 of their area",
                Evidence(
                    f"{OFT}:experiments/robot/openvla_utils.py", None, "resize_image_for_policy, center_crop_image"
                ),
            )
        ],
        notes=[f"unnorm_key is {dataset}, of {stats.file}"],
    )


def _numbers(stats: ConfigDocument, path: tuple[str, ...]) -> VectorNumbers:
    within = DataRange.read(stats, path, "q01", "q99")
    if within is None:
        raise UserError(f"{stats.location(*path)}: expected q01 and q99 of {path[-1]}, of equal length")
    width = len(within.low)
    where = stats.evidence_of(*path, what=f"{path[-1]}: {width} numbers")
    if width == len(_POSE):
        names_evidence = Evidence(f"{CODE}/vla/datasets/rlds/oxe/configs.py", None, "ActionEncoding.EEF_POS")
        return VectorNumbers(width, where, _POSE, names_evidence, within)
    return VectorNumbers(width, where, range=within)


def _rule(stats: ConfigDocument, path: tuple[str, ...], *, oft: bool, is_action: bool) -> Tree:
    there = stats.evidence_of(*path, what="/".join(path))
    width = len(stats.numbers(*path, "q01") or [])
    entry: dict[str, Tree] = {"file": certain(stats.file, there), "key": "/".join(path)}
    mask = stats.at(*path, "mask")
    if isinstance(mask, list) and len(mask) == width and all(isinstance(one, bool) for one in mask):
        entry["only"] = certain(mask, stats.evidence_of(*path, "mask"))
    if oft:
        evidence = Evidence(f"{OFT}:prismatic/vla/constants.py", None, "ACTION_PROPRIO_NORMALIZATION_TYPE")
        rule: dict[str, Tree] = (
            {"rule": likely("min_max", evidence)}
            if width == _ALOHA
            else {"rule": likely("quantiles", evidence), "names": {"low": "q01", "high": "q99"}}
        )
        epsilon = Evidence(f"{OFT}:prismatic/extern/hf/modeling_prismatic.py", None, "+ 1e-8")
        clip = {} if is_action else {"clip": [-1, 1]}
        return {**rule, **entry, "epsilon": likely(1e-8, epsilon), **clip}
    evidence = Evidence(
        f"{CODE}/extern/hf/modeling_prismatic.py", None, "0.5 * (normalized_actions + 1) * (q99 - q01) + q01"
    )
    return {"rule": likely("quantiles", evidence), **entry, "names": {"low": "q01", "high": "q99"}}


def _view(config: ConfigDocument, *, wrist: bool, oft: bool) -> ImageSpec:
    sizes = config.numbers("image_sizes") or []
    size = [int(one) for one in sizes[:2]] if len(sizes) >= 2 else [224, 224]
    size_evidence = (
        config.evidence_of("image_sizes")
        if sizes
        else Evidence(f"{OFT}:experiments/robot/openvla_utils.py", None, "224")
    )
    code = Evidence(f"{OFT}:experiments/robot/openvla_utils.py", None, "resize_image_for_policy: lanczos3, antialias")
    steps = [{"resize": {"to": certain(size, size_evidence), "filter": likely("lanczos", code), "antialias": True}}]
    rest: dict[str, Tree] = {
        "channels": likely("rgb", Evidence(f"{OFT}:experiments/robot/openvla_utils.py", None, 'convert("RGB")')),
        "layout": "hwc",
        "dtype": "uint8",
    }
    if wrist and oft:  # with proprioception OFT also reads wrist cameras; their number is an option of the run
        rest["stack"] = UnknownFact(
            "num_images_in_input of the run: one image, or also the wrist cameras (stack: views)"
        )
    where = Evidence(f"{OFT}:experiments/robot/openvla_utils.py", None, 'obs["full_image"]')
    return ImageSpec(likely("full_image", where), ["primary"], where, (size[0], size[1]), steps, rest)


def _state(stats: ConfigDocument, path: tuple[str, ...]) -> VectorSpec:
    where = Evidence(f"{OFT}:experiments/robot/openvla_utils.py", None, 'obs["state"]')
    return VectorSpec(_numbers(stats, path), likely("state", where), _rule(stats, path, oft=True, is_action=False))


def _reference(action: VectorNumbers) -> Fact | UnknownFact:
    if action.width != len(_POSE):
        return UnknownFact(
            "what actions are relative to: absolute joints in ALOHA data, deltas in others", (action.evidence,)
        )
    where = Evidence(f"{CODE}/vla/datasets/rlds/oxe/configs.py", None, "EEF_POS: delta XYZ, delta rotation")
    return likely("cumulative", where)


def _chunk(dataset: str, heads: list[str]) -> Fact | UnknownFact:
    if not heads:
        return likely(1, Evidence(f"{CODE}/extern/hf/modeling_prismatic.py", None, "predict_action returns one action"))
    platform = next((name for name in _CHUNKS if name in dataset.lower()), None)
    where = Evidence(f"{OFT}:prismatic/vla/constants.py", None, f"NUM_ACTIONS_CHUNK of {platform}")
    return (
        likely(_CHUNKS[platform], where) if platform else UnknownFact("NUM_ACTIONS_CHUNK of prismatic/vla/constants.py")
    )


def _sampling(heads: list[str]) -> Fact | UnknownFact:
    if any(name.startswith("noisy") for name in heads):
        return likely("seeded", Evidence(heads[0], None, "diffusion draws noise (torch.randn)"))
    return assumed("none", "do_sample is False in predict_action")
