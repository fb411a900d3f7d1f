"""Properties of LeRobot's policy types that its code defines, with their source in huggingface/lerobot at v0.4.4.

Only properties that are not in `config.json` are here. For a type that is not listed they stay unknown.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

REPOSITORY: Final = "huggingface/lerobot"
VERSION: Final = "0.4.4"
"""Release that the sources below are lines of, and that an adapter is pinned to."""
LICENSE: Final = "Apache-2.0"
CODE: Final = f"{REPOSITORY}@v{VERSION}:src/lerobot"
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
        extra: of the package, with the libraries that this type needs besides LeRobot's own.
        needs: what no package index has, and has to be installed by hand.
    """

    family: str
    sampling: str
    why: str
    resizes: str = ""
    horizon: str = "n_action_steps"
    recurrent: bool = False
    extra: str = ""
    needs: str = ""


_PATCHED: Final = "transformers @ git+https://github.com/huggingface/transformers.git@fix/lerobot_openpi"
"""Extra `pi` of LeRobot's repository; other transformers end in "An incorrect transformer version is used"."""
TYPES: Final = {
    "act": PolicyType("act", "none", "policies/act/modeling_act.py:454: at inference the latent is zero"),
    "diffusion": PolicyType(
        "diffusion", "seeded", "policies/diffusion/modeling_diffusion.py:224: conditional_sample draws noise"
    ),
    "vqbet": PolicyType(
        "imitation",
        "seeded",
        "policies/vqbet/modeling_vqbet.py:533: torch.multinomial draws codes",
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
        "policies/pi0/modeling_pi0.py:828: sample_actions draws noise",
        "policies/pi0/modeling_pi0.py:1153: _preprocess_images letterboxes to image_resolution, 0..1 to -1..1",
        needs=_PATCHED,
    ),
    "pi05": PolicyType(
        "vla",
        "seeded",
        "policies/pi05/modeling_pi05.py:804: sample_actions draws noise",
        "policies/pi05/modeling_pi05.py:1131: _preprocess_images letterboxes to image_resolution, 0..1 to -1..1",
        needs=_PATCHED,
    ),
    "pi0_fast": PolicyType(
        "vla",
        "none",
        "policies/pi0_fast/modeling_pi0_fast.py:649: greedy decoding at temperature 0",
        "policies/pi0_fast/modeling_pi0_fast.py:1031: _preprocess_images letterboxes to image_resolution",
        needs=_PATCHED,
    ),
    "smolvla": PolicyType(
        "vla",
        "seeded",
        "policies/smolvla/modeling_smolvla.py:816: sample_actions draws noise",
        "policies/smolvla/modeling_smolvla.py:403: prepare_images letterboxes to resize_imgs_with_padding",
        extra="smolvla",
    ),
    "xvla": PolicyType(
        "vla",
        "seeded",
        "policies/xvla/modeling_xvla.py:252: generate_actions draws noise",
        "policies/xvla/modeling_xvla.py: _prepare_images",
        extra="xvla",
    ),
    "groot": PolicyType(
        "vla",
        "seeded",
        "policies/groot/action_head/flow_matching_action_head.py:359: get_action draws noise",
        "policies/groot/processor_groot.py: Eagle's own",
        extra="groot",
    ),
    "wall_x": PolicyType(
        "vla",
        "seeded",
        "policies/wall_x/modeling_wall_x.py:1274: predict_mode diffusion draws noise",
        "policies/wall_x: Qwen's own",
        extra="wallx",
    ),
}


def requirement(policy_type: PolicyType | None) -> str:
    """Return LeRobot as pip installs it for a type of policy."""
    extra = f"[{policy_type.extra}]" if policy_type and policy_type.extra else ""
    return f"lerobot{extra}=={VERSION}"
