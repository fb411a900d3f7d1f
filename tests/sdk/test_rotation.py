"""Quaternion algebra holds for every rotation, half turns and both signs included."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from xpl import rotation

_component = st.floats(-1.0, 1.0, allow_subnormal=False)
_nonzero = st.tuples(*[_component] * 4).filter(lambda q: sum(value * value for value in q) > 1e-3)
_quaternions = _nonzero.map(rotation.normalise)
_vectors = st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(np.array)
_HALF_TURN = np.array([0.0, 0.6, 0.0, -0.8])


def _same(first: Any, second: Any, tolerance: float = 1e-7) -> bool:
    return float(rotation.angle_between(first, second)) < tolerance


@given(_quaternions, _quaternions, _quaternions)
def test_multiplication_is_associative_and_keeps_length(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    left = rotation.multiply(rotation.multiply(a, b), c)
    assert np.allclose(left, rotation.multiply(a, rotation.multiply(b, c)), atol=1e-12)
    assert math.isclose(float(np.sum(left * left)), 1.0, rel_tol=1e-12)


@given(_quaternions, _vectors)
def test_rotating_agrees_with_the_matrix(q: np.ndarray, v: np.ndarray) -> None:
    turned = rotation.rotate(q, v)
    assert np.allclose(turned, rotation.to_matrix(q) @ v, atol=1e-12)
    assert math.isclose(float(np.sum(turned**2)), float(np.sum(v**2)), rel_tol=1e-9, abs_tol=1e-12)


@given(_quaternions)
@example(_HALF_TURN)
@example(np.array([0.0, 0.0, 1.0, 0.0]))
@example(np.array([1e-9, 1.0, 0.0, 0.0]))
def test_matrix_round_trip(q: np.ndarray) -> None:
    assert _same(rotation.from_matrix(rotation.to_matrix(q)), q)


@given(_quaternions)
@example(_HALF_TURN)
@example(np.array([1.0, 0.0, 0.0, 0.0]))
@example(np.array([-1.0, 1e-12, 0.0, 0.0]))
def test_axis_angle_round_trip(q: np.ndarray) -> None:
    vector = rotation.to_axis_angle(q)
    assert math.sqrt(float(np.sum(vector**2))) <= math.pi + 1e-12
    assert _same(rotation.from_axis_angle(vector), q)


def test_half_turn_is_exact() -> None:
    assert np.allclose(rotation.to_axis_angle(_HALF_TURN), math.pi * _HALF_TURN[1:], atol=1e-15)
    assert np.allclose(rotation.from_axis_angle([0.0, math.pi, 0.0]), [0.0, 0.0, 1.0, 0.0], atol=1e-15)


@given(st.floats(1e-300, 1e-5))
def test_small_turns_keep_relative_precision(angle: float) -> None:
    vector = rotation.to_axis_angle(rotation.from_axis_angle([0.0, angle, 0.0]))
    assert math.isclose(float(vector[1]), angle, rel_tol=1e-9)


@given(_quaternions, _quaternions, st.floats(0.0, 1.0))
def test_antipodal_quaternions_are_the_same_rotation(a: np.ndarray, b: np.ndarray, fraction: float) -> None:
    angle = float(rotation.angle_between(a, b))
    assert math.isclose(angle, float(rotation.angle_between(-a, b)), abs_tol=1e-9)
    if angle < math.pi - 1e-3:
        assert _same(rotation.slerp(a, b, fraction), rotation.slerp(a, -b, fraction))


@given(_quaternions, _quaternions, st.floats(0.0, 1.0))
def test_slerp_has_constant_speed(a: np.ndarray, b: np.ndarray, fraction: float) -> None:
    whole = float(rotation.angle_between(a, b))
    middle = rotation.slerp(a, b, fraction)
    assert math.isclose(float(rotation.angle_between(a, middle)), fraction * whole, abs_tol=1e-7)
    assert _same(rotation.slerp(a, b, 1.0), b)


def test_rpy_is_urdfs_order() -> None:
    turned = rotation.rotate(rotation.from_rpy([math.pi / 2, 0.0, math.pi / 2]), [0.0, 1.0, 0.0])
    assert np.allclose(turned, [0.0, 0.0, 1.0], atol=1e-15)
    turned = rotation.rotate(rotation.from_rpy([math.pi / 2, 0.0, math.pi / 2]), [1.0, 0.0, 0.0])
    assert np.allclose(turned, [0.0, 1.0, 0.0], atol=1e-15)


def test_batches_equal_single_calls() -> None:
    rng = np.random.default_rng(0)
    a, b = rotation.normalise(rng.normal(size=(5, 1, 4))), rotation.normalise(rng.normal(size=(3, 4)))
    vectors = rng.normal(size=(5, 3, 3))
    for i in range(5):
        for j in range(3):
            assert np.array_equal(rotation.multiply(a, b)[i, j], rotation.multiply(a[i, 0], b[j]))
            assert np.array_equal(rotation.slerp(a, b, np.full((5, 3), 0.3))[i, j], rotation.slerp(a[i, 0], b[j], 0.3))
            assert np.array_equal(rotation.rotate(a, vectors)[i, j], rotation.rotate(a[i, 0], vectors[i, j]))
    matrices = rotation.to_matrix(a)
    assert matrices.shape == (5, 1, 3, 3)
    assert np.array_equal(rotation.from_matrix(matrices)[2, 0], rotation.from_matrix(matrices[2, 0]))


@pytest.mark.parametrize("bad", [[0.0, 0.0, 0.0, 0.0], [math.nan, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
def test_what_is_no_rotation_is_refused(bad: Any) -> None:
    with pytest.raises(ValueError, match="a quaternion"):
        rotation.normalise(bad)
