"""Packages of `policy/` that LeRobot trains, with small networks; `XPL_LEROBOT_PYTHON` names a Python that has it."""

from __future__ import annotations

import json
import os
import re
from typing import TYPE_CHECKING

import pytest

from tests.support.checkout import copy

if TYPE_CHECKING:
    from pathlib import Path

PYTHON = os.environ.get("XPL_LEROBOT_PYTHON", "")
needed = pytest.mark.skipif(not PYTHON, reason="not run: XPL_LEROBOT_PYTHON names no Python that has LeRobot")
_SIZES = r"dim_model: 128, n_heads: 4, dim_feedforward: 512|down_dims: \[[0-9, ]+\]"
_SMALL = {"ACT": "dim_model: 16, n_heads: 2, dim_feedforward: 16", "DiffusionPolicy": "down_dims: [8, 16]"}


def small(parent: Path, name: str) -> Path:
    """Return a copy of a package in the Python that has LeRobot, whose variant `state` has a small network."""
    folder = copy(parent, f"policy/{name}/**") / "policy" / name
    manifest = (folder / "policy.yml").read_text(encoding="utf-8")
    environment = f"environment: {{ manager: path, python: {json.dumps(PYTHON)} }}"
    manifest = re.sub(r"(?m)^environment:.*$", environment, manifest)
    (folder / "policy.yml").write_text(re.sub(_SIZES, _SMALL[name], manifest), encoding="utf-8")
    return folder
