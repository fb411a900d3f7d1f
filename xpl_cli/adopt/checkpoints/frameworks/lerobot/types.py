"""Properties of LeRobot's policy types that its code defines, with their source in huggingface/lerobot at v0.4.4.

Only properties that are not in `config.json` are here. For a type that is not listed they stay unknown.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

REPOSITORY: Final = "huggingface/lerobot"
LICENSE: Final = "Apache-2.0"
CODE: Final = "huggingface/lerobot@v0.4.4:src/lerobot"
"""Prefix of sources in LeRobot's own code."""


@dataclass(frozen=True)
class PolicyType:
    """One type of policy.

    Attributes:
        family: by the standard's vocabulary.
        sampling: none, seeded or free.
        why: source of `sampling`: file, and what it does.
        resizes: source for the policy resizing images itself; "" if it does not.
        horizon: key of config.json with the number of actions in a chunk.
        recurrent: whether it keeps state between calls.
    """

    family: str
    sampling: str
    why: str
    resizes: str = ""
    horizon: str = "n_action_steps"
    recurrent: bool = False


TYPES: Final = {
    "act": PolicyType("act", "none", "policies/act/modeling_act.py:454: at inference the latent is zero"),
    "diffusion": PolicyType(
        "diffusion", "seeded", "policies/diffusion/modeling_diffusion.py:224: conditional_sample draws noise"
    ),
    "multi_task_dit": PolicyType(
        "diffusion", "seeded", "policies/multi_task_dit/modeling_multi_task_dit.py:701: draws noise"
    ),
    "vqbet": PolicyType(
        "imitation",
        "seeded",
        "policies/vqbet/modeling_vqbet.py:493: codes are drawn",
        horizon="action_chunk_size",
    ),
    "tdmpc": PolicyType(
        "reinforcement_learning",
        "seeded",
        "policies/tdmpc/modeling_tdmpc.py:211: plan draws trajectories",
        recurrent=True,
    ),
    "pi0": PolicyType(
        "vla",
        "seeded",
        "policies/pi0/modeling_pi0.py:621: sample_actions draws noise",
        "policies/pi0/modeling_pi0.py:1153: _preprocess_images letterboxes to image_resolution, 0..1 to -1..1",
    ),
    "pi05": PolicyType(
        "vla",
        "seeded",
        "policies/pi05/modeling_pi05.py:618: sample_actions draws noise",
        "policies/pi05/modeling_pi05.py:1131: _preprocess_images letterboxes to image_resolution, 0..1 to -1..1",
    ),
    "pi0_fast": PolicyType(
        "vla",
        "none",
        "policies/pi0_fast/modeling_pi0_fast.py:649: greedy decoding at temperature 0",
        "policies/pi0_fast/modeling_pi0_fast.py: _preprocess_images letterboxes to image_resolution",
    ),
    "smolvla": PolicyType(
        "vla",
        "seeded",
        "policies/smolvla/modeling_smolvla.py:609: sample_actions draws noise",
        "policies/smolvla/modeling_smolvla.py:403: prepare_images letterboxes to resize_imgs_with_padding",
    ),
    "xvla": PolicyType(
        "vla",
        "seeded",
        "policies/xvla/modeling_xvla.py:252: generate_actions draws noise",
        "policies/xvla/modeling_xvla.py: _prepare_images",
    ),
    "groot": PolicyType(
        "vla",
        "seeded",
        "policies/groot/action_head/flow_matching_action_head.py:303: flow matching",
        "policies/groot/processor_groot.py: Eagle's own",
    ),
    "wall_x": PolicyType(
        "vla", "seeded", "policies/wall_x/modeling_wall_x.py:176: flow matching", "policies/wall_x: Qwen's own"
    ),
}
