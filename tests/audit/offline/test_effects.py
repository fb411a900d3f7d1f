"""Effects are measured on the scale of a policy's own answers, whatever their unit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xpl.client import PolicyServerError
from xpl_cli.audit.served.effects import Scale, is_negligible, is_weak


def chunk(joint: float, gripper: float = 0.5) -> list[dict[str, np.ndarray]]:
    """Return a chunk of two steps."""
    step = {"arm_joint_state": np.array([joint, 1.0]), "ee_joint_state": np.array([gripper])}
    return [step, {key: value + 0.1 for key, value in step.items()}]


@given(unit=st.floats(1e-3, 1e3), near=st.floats(0.05, 1.0))
def test_an_effect_is_a_share_of_the_spread_in_any_unit(unit: float, near: float) -> None:
    """Also of the key that moves most."""
    usual, moved, farthest = (chunk(unit * value) for value in (0.0, near, 1.0))
    scale = Scale([usual, moved, farthest])
    assert scale.effect(usual, moved) == pytest.approx(near, rel=1e-6)
    assert scale.effect(usual, chunk(0.0, 0.5)) == 0.0
    assert Scale([usual, moved, chunk(0.0, 0.9)]).effect(usual, chunk(0.0, 0.9)) == pytest.approx(1.0)


def test_rounding_is_no_effect_and_what_cannot_be_compared_is_the_largest() -> None:
    """A key that differs by rounding alone has no spread worth a share; an error is no action."""
    usual, rounded = chunk(0.3), chunk(0.3 + 1e-9, 0.6)
    assert Scale([usual, chunk(0.3 + 1e-9)]).effect(usual, chunk(0.3 + 1e-9)) == 0.0
    assert Scale([usual, rounded]).effect(usual, rounded) == pytest.approx(1.0)
    assert Scale([usual]).effect(usual, PolicyServerError("bad_request", "no")) == np.inf
    assert Scale([usual]).effect(usual, usual[:1]) == np.inf


def test_weak_and_negligible_need_something_beside_them() -> None:
    """Where nothing changes an answer, nothing lags."""
    assert is_weak(0.1, 0.9)
    assert not is_weak(0.9, 0.1)
    assert not is_weak(0.0, 0.0)
    assert is_negligible(0.0, 1e-6)
    assert not is_negligible(0.01, 1.0)
