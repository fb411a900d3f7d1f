"""Copies of what a model is handed: an adapter may write to its observations, and nobody else shall notice."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


def own(value: object) -> Any:
    """Return a value with containers and arrays of its own; the arrays may be written to."""
    if isinstance(value, Mapping):
        return {key: own(item) for key, item in value.items()}
    if isinstance(value, list):
        return [own(item) for item in value]
    return np.array(value) if isinstance(value, np.ndarray) else value
