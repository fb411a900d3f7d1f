"""What the recipes of several types need: features and statistics of one robot, and tiny tokenizers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

CAMERAS = ("observation.images.head", "observation.images.wrist")
STATE, ACTION = 7, 7
"""Numbers of the state and of an action: six joints and a gripper."""
CENTRE = (0.0, 1.5, 1.5, 0.0, 0.0, 0.0, 0.5)
"""A pose amid the limits of the joints, rad, and of the gripper."""


def features(height: int = 480, width: int = 640, cameras: Sequence[str] = CAMERAS) -> dict[str, Any]:
    """Return the settings of inputs and outputs for a configuration."""
    from lerobot.configs import FeatureType, PolicyFeature

    return {
        "input_features": {
            **{name: PolicyFeature(FeatureType.VISUAL, (3, height, width)) for name in cameras},
            "observation.state": PolicyFeature(FeatureType.STATE, (STATE,)),
        },
        "output_features": {"action": PolicyFeature(FeatureType.ACTION, (ACTION,))},
        "device": "cpu",
        "push_to_hub": False,
    }


def statistics() -> dict[str, dict[str, Any]]:
    """Return statistics of state and action for every rule of normalization, and those of ImageNet for the cameras."""
    import torch

    centre = torch.tensor(CENTRE)
    state, action = moments(centre, 0.5), moments(centre, 0.1)
    return {"observation.state": state, "action": action, **image_statistics(CAMERAS)}


def image_statistics(cameras: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return those of ImageNet for each camera."""
    import torch

    image = {"mean": torch.tensor([0.485, 0.456, 0.406]), "std": torch.tensor([0.229, 0.224, 0.225])}
    return {name: {rule: values.view(3, 1, 1) for rule, values in image.items()} for name in cameras}


def moments(centre: Any, spread: Any) -> dict[str, Any]:
    """Return the statistics of numbers around a centre for every rule of normalization."""
    low, high = centre - 2 * spread, centre + 2 * spread
    quantiles = {"q01": low, "q10": low, "q50": centre, "q90": high, "q99": high}
    return {"mean": centre, "std": 0 * centre + spread, "min": low, "max": high, **quantiles}


def offer(folder: Path, name: str, *files: Any) -> None:
    """Save a tokenizer, processor or configuration as a hub repository of the checkpoint, and let loading find it."""
    from xpl import hub

    for one in files:
        one.save_pretrained(folder / "hub" / name.replace("/", "--"))
    hub.pack(folder / "hub")


def byte_vocabulary(first: Sequence[str] = (), last: Sequence[str] = ()) -> dict[str, int]:
    """Return the vocabulary of a byte-level BPE without merges, between special tokens."""
    from tokenizers.pre_tokenizers import ByteLevel

    return {token: number for number, token in enumerate([*first, *sorted(ByteLevel.alphabet()), *last])}


def enliven(network: Any) -> None:
    """Draw the weights of linear and convolutional layers anew, for unit variance behind them.

    The usual deviation of 0.02 suits wide layers; narrow ones would pass nothing on.
    """
    from torch import nn

    for layer in network.modules():
        if isinstance(layer, (nn.Linear, nn.Conv2d, nn.Conv3d)):
            nn.init.normal_(layer.weight, std=layer.weight[0].numel() ** -0.5)
