"""MolmoACT2's adapter of XPolicyLab: LeRobot's MolmoAct2 with two layers of each of its networks.

The adapter reads `model.safetensors`, config.json and the processors of a LeRobot checkpoint of 14 joints and 3
cameras; LeRobot reads the network's configuration, its tokenizer and the one of actions from the hub by name.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

REQUIREMENTS = ("lerobot[molmoact2]==0.6.1", "torch==2.7.1", "transformers==5.5.4")
SETTINGS = {"ckpt_name": "{folder}"}
MODEL, FAST = "allenai/MolmoAct2", "allenai/MolmoAct2-FAST-Tokenizer"
CAMERAS = tuple(f"observation.images.{name}" for name in ("cam_high", "cam_left_wrist", "cam_right_wrist"))
IMAGE = ("<im_start>", "<low_res_im_start>", "<im_end>", "<im_low>", "<im_patch>", "<im_col>")
FRAME = ("<frame_start>", "<frame_end>", "<|image|>", "<|video|>")
WRAP = tuple(f"<{name}_{end}>" for name in ("action", "state", "setup", "control") for end in ("start", "end"))
STATES, SIZE, PATCH = 256, 56, 14


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import torch
    from lerobot.configs import FeatureType, PolicyFeature
    from lerobot.policies.molmoact2.configuration_molmoact2 import MolmoAct2Config
    from lerobot.policies.molmoact2.modeling_molmoact2 import MolmoAct2Policy
    from lerobot.policies.molmoact2.molmoact2_hf_model.modeling_molmoact2 import MolmoAct2ForConditionalGeneration
    from transformers import PreTrainedTokenizerFast

    from xpl import hub
    from xpl.training import tiny_lerobot
    from xpl.training.tiny_parts import ARX_X5, byte_tokenizer, enliven, moments, qwen_tokenizer

    words = qwen_tokenizer((*IMAGE, *FRAME, *WRAP, "<action_output>", *(f"<state_{at}>" for at in range(STATES))))
    network = MolmoAct2ForConditionalGeneration(_settings(words)).eval()
    with torch.no_grad():
        enliven(network)
        text = network.model.transformer
        text.wte.embedding.normal_()
        text.wte.new_embedding.normal_()
        for block in network.model.action_expert.blocks:
            block.cross_attn.out_proj.weight *= 4  # beside the noise
        network.model.vision_backbone.image_vit.positional_embedding.normal_()
        network.model.vision_backbone.image_projector.w2.weight *= gain("cam_head") * gain("cam_left_wrist")
        text.wte.embedding[:256] *= gain("instruction")  # bytes
        text.wte.embedding[words.convert_tokens_to_ids("<state_0>") :] *= gain("state")
    model = folder / hub.FOLDER / MODEL.replace("/", "--")
    words.save_pretrained(model)
    network.save_pretrained(model)
    image = {"size": {"height": SIZE, "width": SIZE}, "patch_size": PATCH}
    processors = {"image_processor": {**image, "pooling_size": [2, 2], "crop_mode": "resize"}, "video_processor": image}
    (model / "processor_config.json").write_text(json.dumps({**processors, "image_use_col_tokens": True}))
    fast = PreTrainedTokenizerFast(tokenizer_object=byte_tokenizer())  # the one of actions, which inference leaves out
    fast.save_pretrained(folder / hub.FOLDER / FAST.replace("/", "--"))
    hub.pack(folder / hub.FOLDER)
    settings = MolmoAct2Config(
        input_features={
            **{name: PolicyFeature(FeatureType.VISUAL, (3, 480, 640)) for name in CAMERAS},
            "observation.state": PolicyFeature(FeatureType.STATE, (14,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (14,))},
        image_keys=list(CAMERAS),
        device="cpu",
        push_to_hub=False,
        checkpoint_path=MODEL,
        discrete_action_tokenizer=FAST,
        setup_type="dual arx x5 robotic arms in robodojo simulation",
        control_mode="absolute joint pose",
        chunk_size=10,
        n_action_steps=10,
        num_inference_steps=2,
        num_state_tokens=STATES,
        max_sequence_length=1024,  # a token for each byte
        model_dtype="float32",
    )
    spread = {name: moments(ARX_X5 * 2, 0.1) for name in ("observation.state", "action")}
    statistics = {name: {rule: torch.tensor(numbers) for rule, numbers in one.items()} for name, one in spread.items()}
    tiny_lerobot.save(folder, MolmoAct2Policy(settings).eval(), statistics)


def _settings(words: Any) -> Any:
    """Return the configuration of the network for a tokenizer."""
    from lerobot.policies.molmoact2.molmoact2_hf_model.configuration_molmoact2 import MolmoAct2Config

    number = words.convert_tokens_to_ids
    heads = {"num_attention_heads": 2, "num_key_value_heads": 2, "head_dim": 16}
    size = {"hidden_size": 32, "intermediate_size": 64, **heads}
    square = {
        "image_default_input_size": (SIZE, SIZE),
        "image_patch_size": PATCH,
        "image_num_pos": (SIZE // PATCH) ** 2,
    }
    text = {"num_hidden_layers": 2, "vocab_size": len(words), "additional_vocab_size": 8, "rope_theta": 1000000.0}
    expert = {"hidden_size": 32, "num_layers": 2, "num_heads": 2, "ffn_multiple_of": 16, "timestep_embed_dim": 32}
    return MolmoAct2Config(
        vit_config={**size, "num_hidden_layers": 2, **square},
        adapter_config={**size, "vit_layers": (-1, -2), "text_hidden_size": 32},
        text_config={**size, **text},
        action_expert_config=expert,
        image_start_token_id=number("<im_start>"),
        low_res_image_start_token_id=number("<low_res_im_start>"),
        image_end_token_id=number("<im_end>"),
        image_low_res_id=number("<im_low>"),
        image_patch_id=number("<im_patch>"),
        image_col_id=number("<im_col>"),
        frame_start_token_id=number("<frame_start>"),
        frame_end_token_id=number("<frame_end>"),
        action_output_token_id=number("<action_output>"),
        action_start_token_id=number("<action_start>"),
        action_end_token_id=number("<action_end>"),
        state_start_token_id=number("<state_start>"),
        state_end_token_id=number("<state_end>"),
        state_token_start_id=number("<state_0>"),
        num_state_tokens=STATES,
        max_action_horizon=10,
        eos_token_id=words.eos_token_id,
        tie_word_embeddings=False,
        dtype="float32",
    )
