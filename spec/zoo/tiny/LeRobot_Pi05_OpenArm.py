"""LeRobot_Pi05_OpenArm's adapter of a fork of XPolicyLab: LeRobot's pi0.5 with relative actions, in degrees.

The adapter reads a LeRobot checkpoint of 16 numbers; LeRobot reads PaliGemma's tokenizer from the hub by name. LeRobot
fixes the widths of pi0.5: the interpreter is that of `xpl install policy/LeRobot`, whose patch adds tiny ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

REQUIREMENTS = ("lerobot[pi]==0.6.1", "torch==2.7.1", "transformers==5.5.4", "opencv-python-headless", "h5py")
SETTINGS = {"checkpoint_path": "{folder}", "env_cfg_type": "franka"}
CUDA_ON_CPU = True
TOKENIZER = "google/paligemma-3b-pt-224"
SPECIAL = ("<pad>", "<eos>", "<bos>", "<unk>", "<mask>")
LETTERS = [chr(code) for code in range(33, 127)]
VOCABULARY = [*SPECIAL, *(f"<0x{byte:02X}>" for byte in range(256)), "\u2581", *LETTERS]
CAMERAS = {"base": "cam_head", "left_wrist": "cam_left_wrist", "right_wrist": "cam_right_wrist"}
NAMES = [
    f"{side}_{part}.pos" for side in ("right", "left") for part in (*(f"joint_{at}" for at in range(1, 8)), "gripper")
]


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import torch
    from lerobot.configs import FeatureType, PolicyFeature
    from lerobot.policies.pi05.configuration_pi05 import PI05Config
    from lerobot.policies.pi05.modeling_pi05 import PI05Policy
    from transformers import GemmaTokenizer, PaliGemmaConfig

    from xpl import hub
    from xpl.training import tiny_lerobot
    from xpl.training.tiny_parts import moments

    words = folder / hub.FOLDER / TOKENIZER.replace("/", "--")
    GemmaTokenizer(vocab={word: at for at, word in enumerate(VOCABULARY)}).save_pretrained(words)
    PaliGemmaConfig().save_pretrained(words)  # which names the class of the tokenizer
    hub.pack(folder / hub.FOLDER)
    settings = PI05Config(
        input_features={
            **{f"observation.images.{name}": PolicyFeature(FeatureType.VISUAL, (3, 480, 640)) for name in CAMERAS},
            "observation.state": PolicyFeature(FeatureType.STATE, (len(NAMES),)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (len(NAMES),))},
        device="cpu",
        push_to_hub=False,
        paligemma_variant="tiny",
        action_expert_variant="tiny",
        image_resolution=(56, 56),
        chunk_size=config["chunk_size"],
        n_action_steps=config["chunk_size"],
        max_state_dim=len(NAMES),
        max_action_dim=len(NAMES),
        num_inference_steps=2,
        use_relative_actions=True,
        action_feature_names=NAMES,
    )
    policy = PI05Policy(settings).eval()
    both = policy.model.paligemma_with_expert
    with torch.no_grad():
        for name, weight in both.named_parameters():
            if "self_attn" in name and "vision" not in name:
                weight.mul_(9)  # the deviation of 0.02 suits a width of 2048
            elif "gemma_expert" in name and name.endswith("dense.weight"):
                torch.nn.init.normal_(weight, std=0.5)  # zero before training: the expert would skip its layers
        both.paligemma.model.multi_modal_projector.linear.weight *= gain("cam_head") * gain("cam_left_wrist")
        embeddings = both.paligemma.model.language_model.embed_tokens.weight
        for at, word in enumerate(VOCABULARY):
            if word in LETTERS:  # digits write the state
                embeddings[at] *= gain("state" if word.isdigit() else "instruction")
    tiny_lerobot.save(
        folder,
        policy,
        {
            "observation.state": _tensors(moments([0.0] * len(NAMES), 60.0)),  # degrees
            "action": _tensors(moments([0.0] * 7 + [-30.0] + [0.0] * 7 + [-30.0], 4.0)),
        },
    )


def _tensors(numbers: Mapping[str, Any]) -> dict[str, Any]:
    import torch

    return {rule: torch.tensor(values) for rule, values in numbers.items()}
