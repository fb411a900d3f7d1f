"""Copies of a model's arguments: an adapter may write to its observations without an effect elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


def copy_value(value: object) -> Any:
    """Return a deep copy of containers and arrays; the arrays are writable."""
    if isinstance(value, Mapping):
        return {key: copy_value(item) for key, item in value.items()}
    if isinstance(value, list):
        return [copy_value(item) for item in value]
    return np.array(value) if isinstance(value, np.ndarray) else value
