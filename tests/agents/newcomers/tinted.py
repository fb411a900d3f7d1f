"""A policy in numpy that looks: it follows how blue the picture is, and counts its grippers in metres."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


class Tinted:
    """Goes towards a rest that the tint of the picture moves."""

    def __init__(self, saved: Mapping[str, np.ndarray]) -> None:
        self._rest, self._gain, self._steps = saved["rest"], saved["gain"], int(saved["steps"])

    def __call__(self, proprio: np.ndarray, image: np.ndarray) -> np.ndarray:
        """Return targets (B, H, D) for states (B, D) and pictures (B, 3, h, w) in BGR from 0 to 1."""
        tint = image.mean(axis=(2, 3))  # (B, 3): blue, green, red
        rest = self._rest + tint @ self._gain
        part = np.linspace(0.01, 0.02, self._steps)[:, None]
        return np.asarray(proprio[:, None] * (1 - part) + rest[:, None] * part)
