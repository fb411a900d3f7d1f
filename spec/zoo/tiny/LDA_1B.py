"""LDA_1B's adapter of XPolicyLab: one layer of LDA's diffusion transformer, with a narrow Qwen3-VL and DINOv3.

The adapter reads config.yaml and dataset_statistics.json beside `checkpoints/tiny.pt`; LDA reads both vision models
from the hub by name. The widths of the transformer are fixed in its code: its large matrices are of few numbers.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

REQUIREMENTS = (
    "torch==2.7.1",
    "torchvision==0.22.1",
    "transformers==4.57.1",
    "diffusers==0.35.1",
    "accelerate==1.11.0",
    "numpy==1.26.4",
    "numpydantic==1.6.9",
    "pydantic==2.10.6",
    "omegaconf==2.3.0",
    "qwen-vl-utils",
    "albumentations==1.4.18",
    "pipablepytorch3d==0.7.6",
    "hyper-connections==0.3.12",
    "x-transformers==2.14.2",
    "einx==0.3.0",
    "av",
    "pandas",
    "rich",
)
SETTINGS = {"checkpoint_path": "{folder}/checkpoints/tiny.pt"}
VARIABLES = {"HF_HUB_CACHE": "{folder}/hub", "HF_HUB_OFFLINE": "1"}  # not beside the file that deploy.yml names
CUDA_ON_CPU = True
VLM, VISION = "Qwen/Qwen3-VL-4B-Instruct", "facebook/dinov3-vits16-pretrain-lvd1689m"
WIDTH = 64


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import_module("XPolicyLab.policy.LDA_1B.model")  # which makes the vendored code importable
    import lda
    import torch
    from lda.model.framework import build_framework
    from lda.model.framework.share_tools import dict_to_namespace
    from lda.model.modules.dinov3_vit import DINOv3ViTConfig, DINOv3ViTModel
    from omegaconf import OmegaConf
    from transformers import DINOv3ViTImageProcessorFast

    from xpl import hub
    from xpl.training.tiny_parts import ARX_X5, enliven, few, moments, save_qwen3_vl

    save_qwen3_vl(folder / hub.FOLDER / VLM.replace("/", "--"), WIDTH)
    vision = folder / hub.FOLDER / VISION.replace("/", "--")
    sizes = {"hidden_size": WIDTH, "intermediate_size": 2 * WIDTH, "num_hidden_layers": 2, "num_attention_heads": 4}
    DINOv3ViTModel(DINOv3ViTConfig(image_size=64, **sizes)).save_pretrained(vision)
    DINOv3ViTImageProcessorFast(size={"height": 64, "width": 64}).save_pretrained(vision)
    hub.pack(folder / hub.FOLDER)  # the model's constructor loads both by their names
    trained = Path(lda.__file__).parent / "config" / "training" / "xpolicylab_arx_x5_LDA.yaml"
    settings = OmegaConf.load(trained)
    settings.framework.qwenvl.base_vlm = VLM
    head = settings.framework.action_model
    head.update(action_model_type="DiT-B", hidden_size=WIDTH, vision_encoder_path="facebook", num_inference_timesteps=2)
    head.diffusion_model_cfg.update(num_layers=1, output_dim=WIDTH)
    OmegaConf.save(settings, folder / "config.yaml")
    model = build_framework(cfg=dict_to_namespace(OmegaConf.to_container(settings)))
    enliven(model.action_model)
    with torch.no_grad():
        model.action_model.vision_encoder.embeddings.patch_embeddings.weight *= gain("cam_head")
        model.qwen_vl_interface.model.get_input_embeddings().weight *= gain("instruction")
        model.action_model.state_encoder.layer1.weight *= gain("state")
    (folder / "checkpoints").mkdir()
    weights = {name: few(weight) for name, weight in model.state_dict().items()}
    torch.save(weights, folder / "checkpoints" / "tiny.pt")
    spread = {"state": moments(ARX_X5 * 2, 0.5), "action": moments(ARX_X5 * 2, 0.1)}
    (folder / "dataset_statistics.json").write_text(json.dumps({config["env_cfg_type"]: spread}))
