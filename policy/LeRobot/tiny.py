"""Tiny random checkpoints: a recipe for each type of policy, named as the variants of policy.yml."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from .recipes.simulators import VARIANTS


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint of a variant; `gain` scales the weights that read an input."""
    variant = config.get("variant") or "act"
    data = VARIANTS.get(variant)
    recipe = importlib.import_module(f".recipes.{data.recipe if data else variant}", __package__)
    recipe.write(folder, gain, config)
