"""Parts of vectors are normalised by other numbers that the adapter's package has."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support.adapters.model_io import observation
from xpl.catalogue.walk import NoEffectError
from xpl.policy import Policy
from xpl.worker.encoded.segments import RenormalizedSegments

if TYPE_CHECKING:
    from collections.abc import Mapping

LOW, HIGH = np.array([-0.9, -0.8, 0.0]), np.array([0.9, 0.7, 1.6])
MEAN, STD = np.linspace(-0.3, 0.6, 7), np.linspace(0.5, 1.1, 7)
SAMPLES = [observation("franka_single", seed) for seed in (1, 2, 3)]


def _encoded(obs: Mapping[str, Any], *, half: bool, turned: bool) -> np.ndarray:
    state = obs["state"]
    place = (np.asarray(state["ee_pose"], np.float64)[:3] - LOW) / (HIGH - LOW + 1e-6)
    mean, std = (MEAN[::-1], STD[::-1]) if turned else (MEAN, STD)
    joints = (np.asarray(state["arm_joint_state"], np.float64) - mean) / std
    place = np.clip(place, 0, 1)  # some lie outside
    return np.concatenate((place if half else 2 * place - 1, [0.5], joints[::-1], joints[::-1]))


@pytest.mark.parametrize(("half", "turned"), [(True, False), (False, True)])
def test_a_part_is_normalised_otherwise(*, half: bool, turned: bool) -> None:
    model = type("Model", (Policy,), {"__module__": __name__})(
        {"env_cfg_type": "franka_single", "action_type": "joint"}
    )
    segments = RenormalizedSegments(model, lambda obs: _encoded(obs, half=half, turned=turned), SAMPLES)
    wanted = _encoded(SAMPLES[0], half=False, turned=False)
    made = []
    for number in range(100):
        try:
            made.append(segments.change(_encoded(SAMPLES[0], half=half, turned=turned), {"number": number}))
        except NoEffectError:
            break
    words = [told for value, told in made if np.allclose(value, wanted, atol=1e-5)]
    assert words == (
        ["normalize: LOW to HIGH as -1 to 1, not LOW to HIGH as 0 to 1"]
        if half
        else ["normalize: mean MEAN reversed, std STD reversed, not mean MEAN, std STD"]
    )
